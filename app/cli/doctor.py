"""`gridpose doctor`: what is installed, where the data lie, and for everything amiss what to do about it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.markup import escape

from app.cli.configuration import load_settings
from app.cli.examinations import data_folder, database, installation, workers
from app.cli.findings import Finding, State

SIGNS = {State.ok: "[green]ok  [/]", State.warning: "[yellow]warn[/]", State.failed: "[red]FAIL[/]"}


class _Part(NamedTuple):
    title: str
    findings: list[Finding]


def examine(data_dir: Path | None) -> int:
    """Print every finding; return 1 where one is a failure."""
    settings = load_settings(data_dir=data_dir)
    parts = [
        _Part("Installation", list(installation.examine())),
        _Part(f"Data folder {settings.data_dir}", list(data_folder.examine(settings))),
        _Part("Database", list(database.examine(settings))),
        _Part("Workers", list(workers.examine(settings))),
    ]
    console = Console(highlight=False)
    for part in parts:
        console.print(f"[bold]{escape(part.title)}[/]", soft_wrap=True)
        for finding in part.findings:
            console.print(f"  {SIGNS[finding.state]} {escape(finding.what)}", soft_wrap=True)
            if finding.advice:
                console.print(f"       → {escape(finding.advice)}", soft_wrap=True)
    states = [finding.state for part in parts for finding in part.findings]
    failures, warnings = states.count(State.failed), states.count(State.warning)
    console.print(f"{failures} failed, {warnings} to look at, {states.count(State.ok)} in order")
    return 1 if failures else 0
