"""`gridpose keys`: directly on the database, whether or not a service runs."""

from __future__ import annotations

import enum
from datetime import UTC, datetime, timedelta
from typing import Annotated

import typer

from app.cli.context import load_settings, open_context, print_location
from app.cli.options.data_folder import DataDir
from app.client.commands import error_console, fail, print_list
from app.errors import ServiceError
from app.records.activity import Activity, acting
from app.records.readable import unreadable_columns
from app.records.tables import ApiKey
from app.services.installation.context import ServiceContext
from app.services.keys import create_key, list_keys, revoke_key


class Scope(enum.StrEnum):
    """Permissions of a key."""

    read = "read"
    ingest = "ingest"
    upload = "upload"
    admin = "admin"


def create(
    name: Annotated[str, typer.Argument(help="User or purpose of the key; shown in lists.")],
    scope: Annotated[
        Scope,
        typer.Option(
            help="read: GET. ingest: send images and commanded poses. upload: both, create and correct. admin: all."
        ),
    ] = Scope.upload,
    days: Annotated[
        int | None, typer.Option(help="Days of validity.  [default: until revoked]", min=1, max=36500)
    ] = None,
    session: Annotated[
        list[str] | None, typer.Option(help="Id of a session the key is limited to; repeatable.")
    ] = None,
    bytes_per_day: Annotated[
        int | None, typer.Option(help="Image bytes it may send in a day.  [default: no limit]", min=1)
    ] = None,
    data_dir: DataDir = None,
    init: Annotated[
        bool, typer.Option("--init", help="Create an installation where the data folder holds none.")
    ] = False,
) -> int:
    """Create a key and print it, this once, as the last line."""
    installation = _open(data_dir, init=init)
    try:
        with acting(Activity(actor="cli", action="create_key")):
            new = create_key(
                installation,
                name,
                str(scope),
                expires_in=None if days is None else timedelta(days=days),
                session_ids=session or None,
                bytes_per_day=bytes_per_day,
            )
    except ServiceError as error:
        fail(error.detail, error.advice, code=2)
    finally:
        installation.close()
    error_console().print(f"Key {new.key.id} of scope {scope}. Store it: it is shown only here.")
    print(new.secret_key)
    return 0


def show(data_dir: DataDir = None) -> int:
    """Show names, scopes and dates of all keys; never the keys themselves."""
    installation = _open(data_dir)
    rows = []
    cursor: str | None = None
    try:
        while True:
            keys, cursor = list_keys(installation, cursor=cursor)
            for key in keys:
                used = f"{key.last_used_at:%Y-%m-%d}" if key.last_used_at is not None else "never"
                rows.append((key.id, key.name, key.scope, f"{key.created_at:%Y-%m-%d}", used, _state(key)))
            if cursor is None:
                break
    finally:
        installation.close()
    none = "There are no keys yet; create one with `gridpose keys create NAME --scope upload`."
    print_list(("id", "name", "scope", "made", "last used", "state"), rows, none)
    return 0


def revoke(
    key_id: Annotated[str, typer.Argument(help="The key's id, as `keys list` shows it.")],
    data_dir: DataDir = None,
) -> int:
    """Revoke a key, at once and permanently."""
    installation = _open(data_dir)
    try:
        with acting(Activity(actor="cli", action="revoke_key", object_ids=[key_id])):
            revoke_key(installation, key_id)
    except ServiceError as error:
        fail(error.detail, "Run `gridpose keys list` and give the id from its first column.")
    finally:
        installation.close()
    print(f"{key_id} is revoked.")
    return 0


def _open(data_dir: DataDir, *, init: bool = False) -> ServiceContext:
    settings = load_settings(data_dir=data_dir)
    print_location(settings)
    return open_context(settings, init=init)


def _state(key: ApiKey) -> str:
    if unreadable_columns(key):
        return "unreadable, therefore refused; revoke it"
    if key.revoked_at is not None:
        return f"revoked {key.revoked_at:%Y-%m-%d %H:%M}"
    state = "valid"
    if key.expires_at is not None:
        expired = key.expires_at <= datetime.now(UTC)
        state = f"{'expired' if expired else 'valid until'} {key.expires_at:%Y-%m-%d %H:%M}"
    if key.session_ids is not None:
        state += f", {len(key.session_ids)} session{'s' if len(key.session_ids) != 1 else ''} only"
    if key.bytes_per_day is not None:
        state += f", {key.bytes_per_day} bytes a day"
    return state
