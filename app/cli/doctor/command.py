"""`gridpose doctor`: checks of the installation, its data folder and its database, with advice for each problem."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn
from sqlalchemy import make_url

from app.cli.context import load_settings
from app.cli.doctor.environment import check_installation, check_variables, check_workers
from app.cli.options.data_folder import DataDir
from app.services.inspection import (
    CheckResult,
    State,
    backups,
    bucket,
    data_folder,
    database,
    guarded,
    originals,
)
from app.settings import Settings

_SIGNS = {State.ok: "[green]ok  [/]", State.warning: "[yellow]warn[/]", State.failed: "[red]FAIL[/]"}


def doctor(
    data_dir: DataDir = None,
    deep: Annotated[
        bool,
        typer.Option(
            "--deep", help="Also hash every original and read the whole database; the service may run."
        ),
    ] = False,
) -> int:
    """Check this installation and its data folder, with advice for each problem found.

    Ends with 0 when nothing failed, else with 1.
    """
    settings = load_settings(data_dir=data_dir)
    folder, in_bucket = settings.data_dir, settings.blob_url is not None
    results: dict[str, list[CheckResult]] = {
        "Installation": [*check_installation(), *check_variables()],
        f"Data folder {folder}": guarded(data_folder.check(settings), folder),
        f"Database {_address(settings)}".rstrip(): guarded(database.check(settings, deep=deep), folder),
        **({f"Bucket {settings.blob_url}": guarded(bucket.check(settings), folder)} if in_bucket else {}),
        **({"Originals": _check_originals(settings)} if deep else {}),
        "Backups": guarded(backups.check(settings), folder),
        "Workers": guarded(check_workers(settings), folder),
    }
    console = Console(highlight=False, emoji=False)
    for title, part in results.items():
        console.print(f"[bold]{escape(title)}[/]", soft_wrap=True)
        for result in part:
            console.print(f"  {_SIGNS[result.state]} {escape(result.detail)}", soft_wrap=True)
            if result.advice:
                console.print(f"       → {escape(result.advice)}", soft_wrap=True)
    states = [result.state for part in results.values() for result in part]
    failures, warnings = states.count(State.failed), states.count(State.warning)
    console.print(f"{failures} failed, {warnings} warnings, {states.count(State.ok)} ok")
    return 1 if failures else 0


def _check_originals(settings: Settings) -> list[CheckResult]:
    """Hash all originals, with a progress bar on stderr where that is a terminal."""
    console = Console(stderr=True, emoji=False)
    columns = (TextColumn("hashing originals"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("originals", total=None)

        def show(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        check_all = bucket.check_images if settings.blob_url else originals.check
        return guarded(check_all(settings, show), settings.data_dir / "originals")


def _address(settings: Settings) -> str:
    """Return the database's address without its password; nothing for the one in the data folder."""
    return make_url(settings.database_url).render_as_string() if settings.database_url else ""
