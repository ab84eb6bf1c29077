"""Settings and installation of a command, from its options and the environment; failures end the command."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from pydantic import ValidationError
from rich.markup import escape
from sqlalchemy import make_url
from sqlalchemy.exc import DBAPIError

from app.client.commands import error_console, fail
from app.errors import OperationRefused, ServiceError, StorageFull
from app.logs import Logger
from app.records.database import is_damage
from app.records.migrations import NoRoomForCopy, SchemaTooNew
from app.services.installation.context import ServiceContext
from app.settings import Settings, unknown_settings

MIN_FREE_BYTES = 1024 * 1024
"""Free space below which a database or a lock may not be opened: a full disk rarely has none at all."""
REFUSED = 2
"""Exit code where folder, database and pepper do not belong together, or hold no installation: wrong settings."""


log = Logger(__name__)


def load_settings(**options: Any) -> Settings:
    """Return the environment's settings, overridden by the options that are not None; invalid ones end the command."""
    try:
        return Settings(**{name: value for name, value in options.items() if value is not None})
    except ValidationError as error:
        lines = []
        for entry in error.errors():
            field = ".".join(str(part) for part in entry["loc"])
            name = f"GRIDPOSE_{field.upper()}: " if field else ""
            lines.append(name + entry["msg"].removeprefix("Value error, "))
        fail(
            "\n".join(lines), "Settings come from the environment; docs/configuration.md lists them.", code=2
        )


def warn_of_unknown_settings() -> None:
    """Log each variable of ours in the environment that nothing reads: a misspelt setting has no effect."""
    for name, nearest in unknown_settings(os.environ):
        log.warning("unknown_setting", name=name, nearest=nearest)


def open_context(
    settings: Settings, *, init: bool = False, adopt: bool = False, migrate: bool = False, serves: bool = True
) -> ServiceContext:
    """Open data folder and database; a failure ends the command.

    `init` permits to create an installation, `migrate` to upgrade an existing one to this version's schema; `adopt` is
    that of `services.binding.bind`; without `serves` no pepper is needed. From here on, files of this process are
    private to its user.
    """
    os.umask(0o077)
    with data_failures(settings):
        return ServiceContext.open(settings, init=init, adopt=adopt, migrate=migrate, serves=serves)


def print_location(settings: Settings) -> None:
    """Print on stderr the data folder, and the database outside of it, that a command works on."""
    console = error_console()
    console.print(f"data folder {escape(str(settings.data_dir))}")
    if settings.database_url:
        url = make_url(settings.database_url).render_as_string(hide_password=True)
        console.print(f"database {escape(url)}")


@contextmanager
def data_failures(settings: Settings) -> Iterator[None]:
    """End the command with a message where data folder or database cannot be used."""
    try:
        yield
    except OperationRefused as error:
        fail(error.detail, error.advice, code=REFUSED)
    except (SchemaTooNew, NoRoomForCopy) as error:
        fail(f"The data in {settings.data_dir} cannot be used: {error}.")
    except ServiceError as error:
        if error.code == "database_damaged":
            _fail_damaged(settings)
        if isinstance(error, StorageFull):
            _fail_if_full(settings)
        fail(error.detail, error.advice)
    except DBAPIError as error:
        if is_damage(error):
            _fail_damaged(settings)
        _fail_if_full(settings)
        reason = (
            str(error.orig).strip().splitlines()[0] if str(error.orig).strip() else type(error.orig).__name__
        )
        fail(
            f"The database cannot be opened: {reason}",
            f"Check that {_where(settings)} can be written, or run `gridpose doctor`.",
        )
    except OSError as error:
        if error.errno == errno.ENOSPC:
            _fail_if_full(settings)
        _fail_elsewhere(settings, error)
        place = error.filename or settings.data_dir
        if error.errno == errno.EROFS:
            fail(
                f"The data folder {settings.data_dir} is on a disk that is read-only. {place}: {error.strerror}.",
                "Run `gridpose doctor`: it says how to save the data, and `dmesg` why the disk is read-only.",
            )
        fail(
            f"The data folder {settings.data_dir} cannot be used. {place}: {error.strerror or error}.",
            f"Allow this user to read and write it: `chown -R USER {settings.data_dir}`, with USER the service's. "
            "Check that its disk is mounted and writable. Or choose another folder with --data-dir or "
            "GRIDPOSE_DATA_DIR.",
        )


def _fail_elsewhere(settings: Settings, error: OSError) -> None:
    """End the command where the system refused a file that the data folder has nothing to do with."""
    if not isinstance(error.filename, str | bytes):
        return
    named = Path(os.fsdecode(error.filename)).absolute()
    data_dir = settings.data_dir.absolute()
    if named.is_relative_to(data_dir) or data_dir.is_relative_to(named):
        return
    fail(
        f"{named} cannot be used: {error.strerror or error}.",
        "Check that it is there, that this user may use it, and that its disk is mounted, writable and has room.",
    )


def _fail_damaged(settings: Settings) -> NoReturn:
    from app.services.backup import damage_advice

    fail("The database is damaged.", damage_advice(settings), code=REFUSED)


def _fail_if_full(settings: Settings) -> None:
    """End the command where the data folder's disk has no room, which everything else there follows from."""
    folder = next(
        place for place in (settings.data_dir, *settings.data_dir.absolute().parents) if place.exists()
    )
    free = shutil.disk_usage(folder).free
    if free < MIN_FREE_BYTES:
        fail(
            f"The disk of {settings.data_dir} is full: {free} bytes are free.",
            "Remove other files from that disk, or enlarge it; then start again. Nothing that was stored is lost.",
        )


def _where(settings: Settings) -> str | Path:
    return "the database of GRIDPOSE_DATABASE_URL" if settings.database_url else settings.data_dir
