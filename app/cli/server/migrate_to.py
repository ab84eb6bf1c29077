"""`gridpose migrate-to`: an installation moved to PostgreSQL, to S3, or to both."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from app.cli.context import data_failures, load_settings, open_context, print_location
from app.cli.options.data_folder import DataDir
from app.client.commands import error_console, fail
from app.services.backup import move_installation

_MAX_LISTED = 20


def migrate_to(
    database_url: Annotated[
        str | None,
        typer.Option(help="`postgresql+psycopg://user@host/name`: an empty database.  [default: stays]"),
    ] = None,
    blob_url: Annotated[
        str | None, typer.Option(help="`s3://bucket/prefix`, with the AWS_* variables.  [default: stays]")
    ] = None,
    data_dir: DataDir = None,
) -> int:
    """Move this installation to a PostgreSQL database, to an S3 bucket, or to both, while nothing runs.

    Interrupted, repeat it. Every image is read back and every table compared. Ends with 1 where images were missing or
    damaged; everything else was moved then.
    """
    settings = load_settings(data_dir=data_dir)
    if database_url is None and blob_url is None:
        fail("Nothing is to be moved.", "Name --database-url, --blob-url or both.", code=2)
    load_settings(
        data_dir=data_dir, database_url=database_url, blob_url=blob_url
    )  # refuses what is no address
    print_location(settings)
    console = error_console()
    columns = (TextColumn("copying images"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with data_failures(settings):
        source = open_context(settings)
        try:
            with Progress(
                *columns, console=console, transient=True, disable=not console.is_terminal
            ) as shown:
                task = shown.add_task("images", total=None)
                report = move_installation(
                    source,
                    database_url,
                    blob_url,
                    lambda done, total: shown.update(task, completed=done, total=total),
                )
        finally:
            source.close()
    print(f"Installation {report.installation_id} was moved")
    if database_url is not None:
        print(
            f"  database   {sum(report.rows.values())} rows of {len(report.rows)} tables, compared by their digests"
        )
    if blob_url is not None:
        print(f"  images     {report.originals}, each read back; {report.copied} copied by this run")
    print("  next       set in the environment of every service and worker, then start them:")
    if database_url is not None:
        print("             GRIDPOSE_DATABASE_URL, as you named it here")
    if blob_url is not None:
        print("             GRIDPOSE_BLOB_URL, and the AWS_* variables")
    print(
        f"             GRIDPOSE_KEY_PEPPER on other machines: the text of {settings.data_dir / 'key-pepper'}"
    )
    for what, hashes in (("missing", report.missing), ("damaged", report.corrupt)):
        if hashes:
            console.print(f"[yellow]{len(hashes)} images were {what} before:[/] upload them again")
            for sha256 in hashes[:_MAX_LISTED]:
                console.print(f"  {sha256}")
    return 1 if report.missing or report.corrupt else 0
