"""`gridpose backup` and `gridpose restore`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from app.cli.context import data_failures, load_settings, print_location
from app.cli.options.data_folder import DataDir
from app.cli.sizes import megabytes
from app.client.commands import error_console
from app.services.backup import make_backup, restore_backup
from app.services.installation.context import ServiceContext
from app.services.keys import keys_in_force
from app.services.notices import MAX_WEBHOOKS, list_webhooks

_MAX_LISTED = 20


def back_up(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="A new folder, or that of an earlier backup, which is updated."),
    ],
    data_dir: DataDir = None,
    replace_newer: Annotated[
        bool,
        typer.Option("--replace-newer", help="Replace a backup that holds changes this installation lacks."),
    ] = False,
) -> int:
    """Copy database, originals and pepper, all of one moment, while the service runs.

    The backup is as confidential as the data folder. Ends with 1 where originals were missing or damaged; the backup
    then holds all others.
    """
    settings = load_settings(data_dir=data_dir)
    print_location(settings)
    started = time.monotonic()
    with data_failures(settings):
        installation = ServiceContext.open(settings, init=False, migrate=False)
        try:
            report = make_backup(installation, folder, replace_newer=replace_newer)
        finally:
            installation.close()
    manifest = report.manifest
    print(f"Backup of installation {manifest.installation_id} in {folder}, as of {manifest.created_at}")
    print(f"  database   {sum(manifest.rows.values())} rows of schema {manifest.revision}")
    print(f"  originals  {manifest.originals}, {megabytes(manifest.original_bytes)}")
    print(
        f"  copied     {report.copied} originals, {megabytes(report.copied_bytes)}, "
        f"in {time.monotonic() - started:.1f} s"
    )
    _list("missing in the data folder", manifest.missing)
    _list("with other bytes in the data folder", manifest.corrupt)
    return 1 if manifest.missing or manifest.corrupt else 0


def restore(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="A folder that `backup` was given.", exists=True, file_okay=False),
    ],
    data_dir: DataDir = None,
    accept_damage: Annotated[
        bool, typer.Option("--accept-damage", help="Continue where originals in the backup are damaged.")
    ] = False,
    revoke_keys: Annotated[
        bool, typer.Option("--revoke-keys", help="Revoke every key that was valid at that moment.")
    ] = False,
    delete_webhooks: Annotated[
        bool, typer.Option("--delete-webhooks", help="Delete every webhook: for a copy to try things with.")
    ] = False,
) -> int:
    """Restore a backup into an empty data folder and an empty database.

    Ends with 1 where originals are damaged and --accept-damage is given.
    """
    settings = load_settings(data_dir=data_dir)
    print_location(settings)
    with data_failures(settings):
        manifest, damaged = restore_backup(
            folder,
            settings,
            accept_damage=accept_damage,
            revoke_keys=revoke_keys,
            delete_webhooks=delete_webhooks,
        )
        installation = ServiceContext.open(settings, init=False, migrate=False)
        try:
            keys = keys_in_force(installation)
            with installation.database.read() as records:
                webhooks, _ = list_webhooks(records, limit=MAX_WEBHOOKS, cursor=None)
        finally:
            installation.close()
    print(f"Installation {manifest.installation_id} is restored as of {manifest.created_at}")
    print(f"  database   {sum(manifest.rows.values())} rows")
    print(f"  originals  {manifest.originals - len(damaged)}, each verified")
    if revoke_keys:
        print("  keys       all revoked; `gridpose keys create NAME --scope admin` creates one")
    if delete_webhooks:
        print("  webhooks   all deleted; nobody is sent anything")
    print("  next       gridpose serve, with this data folder and database")
    _list_in_force(
        "Keys that are valid, as they were when the backup was made",
        [f"{key.id}  {key.scope}  {key.name}" for key in keys],
        "A key that was revoked since then is valid again: `gridpose keys revoke ID` before you start the service. "
        "--revoke-keys revokes all keys of a restored backup.",
    )
    _list_in_force(
        "Webhooks, which are sent what waited for them and what happens here",
        [f"{webhook.id}  {webhook.name}  {webhook.url}" for webhook in webhooks],
        "Where this is a copy to try things with, restore it with --delete-webhooks.",
    )
    lost = [*manifest.missing, *manifest.corrupt]
    _list("missing or damaged in the installation when the backup was made", lost)
    _list("damaged in the backup", damaged)
    return 1 if damaged else 0


def _list(what: str, hashes: Sequence[str]) -> None:
    if not hashes:
        return
    console = error_console()
    console.print(f"[yellow]{len(hashes)} originals {what}:[/]")
    for sha256 in hashes[:_MAX_LISTED]:
        console.print(f"  {escape(sha256)}")
    if len(hashes) > _MAX_LISTED:
        console.print(f"  and {len(hashes) - _MAX_LISTED} more")
    console.print("Upload these images again.")


def _list_in_force(what: str, entries: Sequence[str], advice: str) -> None:
    """List what a restored service has again as it was at the moment of the backup."""
    if not entries:
        return
    console = error_console()
    console.print(f"[yellow]{what}:[/]")
    for entry in entries:
        console.print(f"  {escape(entry)}")
    console.print(advice)
