"""`gridpose keys`: straight on the database, so that no service need run and none is disturbed."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app.cli.configuration import fail, load_settings, open_installation
from app.errors import ServiceError
from app.records.tables import ApiKey
from app.services.keys import create_key, list_keys, revoke_key


def create(name: str, scope: str, days: int | None, data_dir: Path | None) -> int:
    """Make a key; its only appearance is the last line of stdout."""
    installation = open_installation(load_settings(data_dir=data_dir))
    try:
        new = create_key(installation, name, scope, expires_in=None if days is None else timedelta(days=days))
    except ServiceError as error:
        fail(error.detail, error.advice, code=2)
    finally:
        installation.close()
    Console(stderr=True, highlight=False, soft_wrap=True).print(
        f"Key {new.key.id} of scope {scope}. Keep it: it is shown only here."
    )
    print(new.secret_key)
    return 0


def show(data_dir: Path | None) -> int:
    """List all keys, oldest first."""
    installation = open_installation(load_settings(data_dir=data_dir))
    table = Table("id", "name", "scope", "made", "state", box=None, pad_edge=False)
    cursor: str | None = None
    try:
        while True:
            keys, cursor = list_keys(installation, cursor=cursor)
            for key in keys:
                table.add_row(
                    key.id, escape(key.name), key.scope, f"{key.created_at:%Y-%m-%d %H:%M}", _state(key)
                )
            if cursor is None:
                break
    finally:
        installation.close()
    if table.row_count:
        Console(highlight=False).print(table)
    else:
        print("There are no keys yet; make one with `gridpose keys create NAME --scope upload`.")
    return 0


def revoke(key_id: str, data_dir: Path | None) -> int:
    """Make a key useless."""
    installation = open_installation(load_settings(data_dir=data_dir))
    try:
        revoke_key(installation, key_id)
    except ServiceError as error:
        fail(error.detail, "Run `gridpose keys list` and give the id from its first column.")
    finally:
        installation.close()
    print(f"{key_id} is revoked.")
    return 0


def _state(key: ApiKey) -> str:
    if key.revoked_at is not None:
        return f"revoked {key.revoked_at:%Y-%m-%d %H:%M}"
    if key.expires_at is None:
        return "valid"
    expired = key.expires_at <= datetime.now(UTC)
    return f"{'expired' if expired else 'valid until'} {key.expires_at:%Y-%m-%d %H:%M}"
