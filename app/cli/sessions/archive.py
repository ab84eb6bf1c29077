"""`gridpose sessions archive` and `gridpose sessions restore`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from app.cli.context import data_failures, load_settings, open_context, print_location
from app.cli.options.data_folder import DataDir
from app.cli.sizes import megabytes
from app.client.commands import error_console
from app.services.archive import ArchiveManifest, archive_session, restore_session

_MAX_LISTED = 20


def archive(
    session: Annotated[str, typer.Argument(metavar="SESSION", help="Id or name of the session.")],
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A new file; its name should end in .tar.gz.", dir_okay=False),
    ],
    data_dir: DataDir = None,
    replace: Annotated[bool, typer.Option("--replace", help="Replace a file that is there.")] = False,
) -> int:
    """Write a session with everything in it to one signed file: images, rows, results, reports.

    The service may run meanwhile. Ends with 1 where originals were missing or damaged; the archive then holds all else.
    """
    settings = load_settings(data_dir=data_dir)
    print_location(settings)
    installation = open_context(settings)
    try:
        with data_failures(settings):
            archived = archive_session(installation, session, file, replace=replace)
    finally:
        installation.close()
    print(f"{file}: session {archived.manifest.session_id}, {megabytes(archived.bytes)}")
    _print_content(archived.manifest, archived.fingerprint)
    return int(bool(archived.manifest.missing))


def restore(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="An archive of a session.", exists=True, dir_okay=False)
    ],
    data_dir: DataDir = None,
    fingerprint: Annotated[
        str | None,
        typer.Option(help="The only signing key whose archives are taken, had from the installation itself."),
    ] = None,
) -> int:
    """Restore a session from its archive, with its ids, byte for byte as it was.

    The service may run meanwhile. Every hash and signature is verified before anything is stored.
    """
    settings = load_settings(data_dir=data_dir)
    print_location(settings)
    installation = open_context(settings)
    try:
        with data_failures(settings):
            restored = restore_session(installation, file, trusted=fingerprint)
    finally:
        installation.close()
    print(f"Session {restored.manifest.session_id} is restored as of {restored.manifest.made_at}")
    _print_content(restored.manifest, restored.fingerprint)
    for table, count in restored.already_there.items():
        print(f"  {table:<12} {count} there already, the same")
    if fingerprint is None:
        error_console().print(
            "[yellow]Whose key signed it was not checked: compare it with that of the installation it is from, or give "
            "--fingerprint.[/]"
        )
    return 0


def _print_content(manifest: ArchiveManifest, fingerprint: str) -> None:
    print(f"  name         {manifest.session_name}")
    print(f"  originals    {len(manifest.originals)}, each verified")
    print(f"  rows         {sum(manifest.rows.values())} of schema {manifest.revision}")
    print(f"  reports      {manifest.reports}")
    print(f"  signing key  {fingerprint}")
    if manifest.missing:
        console = error_console()
        console.print(
            f"[yellow]{len(manifest.missing)} originals were missing or damaged in the installation:[/]"
        )
        for sha256 in manifest.missing[:_MAX_LISTED]:
            console.print(f"  {escape(sha256)}")
        if len(manifest.missing) > _MAX_LISTED:
            console.print(f"  and {len(manifest.missing) - _MAX_LISTED} more")
        console.print("Upload these images again to have them in the archive.")
