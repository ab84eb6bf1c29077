"""From options and environment to an open installation, with what cannot be done said in a sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

import typer
from pydantic import ValidationError
from rich.console import Console
from rich.markup import escape
from sqlalchemy.exc import DBAPIError

from app.records.schema import SchemaTooNew
from app.services.installation import Installation
from app.settings import Settings


def fail(message: str, advice: str | None = None, *, code: int = 1) -> NoReturn:
    """Say why the command ends, and what to do, on stderr."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    console.print(f"[red]{escape(message)}[/]")
    if advice:
        console.print(escape(advice))
    raise typer.Exit(code)


def load_settings(**options: Any) -> Settings:
    """Return the environment's settings with the given options before them; ends the command on bad ones."""
    try:
        return Settings(**{name: value for name, value in options.items() if value is not None})
    except ValidationError as error:
        lines = []
        for entry in error.errors():
            field = ".".join(str(part) for part in entry["loc"])
            name = f"GRIDPOSE_{field.upper()}: " if field else ""
            lines.append(name + entry["msg"].removeprefix("Value error, "))
        fail("\n".join(lines), "Settings come from the environment; README.md lists them.", code=2)


def open_installation(settings: Settings) -> Installation:
    """Open data folder and database, made and migrated where needed; ends the command where that fails."""
    try:
        return Installation.open(settings)
    except SchemaTooNew as error:
        fail(f"The data in {settings.data_dir} cannot be used: {error}.")
    except DBAPIError as error:
        reason = (
            str(error.orig).strip().splitlines()[0] if str(error.orig).strip() else type(error.orig).__name__
        )
        fail(
            f"The database cannot be opened: {reason}",
            f"Check that {_where(settings)} can be written, or run `gridpose doctor`.",
        )
    except OSError as error:
        fail(
            f"The data folder {settings.data_dir} cannot be used: {error.strerror or error}.",
            "Give another with --data-dir or GRIDPOSE_DATA_DIR, or allow this user to write there.",
        )


def _where(settings: Settings) -> str | Path:
    return "the database of GRIDPOSE_DATABASE_URL" if settings.database_url else settings.data_dir
