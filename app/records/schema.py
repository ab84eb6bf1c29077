"""The schema's version: what the database has, what this program needs, and the way from one to the other."""

from __future__ import annotations

import importlib.util
from datetime import UTC, datetime
from pathlib import Path

import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory

from app.records.database import Database
from app.records.lock import FileLock

_ADVISORY_LOCK = 0x6772_6964  # "grid": migrations on PostgreSQL exclude one another


class SchemaTooNew(Exception):
    """The database was made by a later version of this program."""


class BrokenReferences(Exception):
    """A migration left rows that refer to nothing."""


def migration_config(connection: sa.Connection | None = None) -> Config:
    """Return Alembic's configuration for the installed `migrations` package."""
    specification = importlib.util.find_spec("migrations")
    if specification is None or not specification.submodule_search_locations:
        raise ModuleNotFoundError("the package `migrations` is not installed")
    config = Config()
    config.set_main_option(
        "script_location", next(iter(specification.submodule_search_locations)).replace("%", "%%")
    )
    config.attributes["connection"] = connection
    return config


def head_revision() -> str:
    """Return the schema version this program needs."""
    head = ScriptDirectory.from_config(migration_config()).get_current_head()
    assert head is not None, "there is always a first migration"
    return head


def current_revision(database: Database) -> str | None:
    """Return the database's schema version; None when it is empty."""
    with database.engine.connect() as connection:
        return MigrationContext.configure(connection).get_current_revision()


def upgrade(database: Database, data_dir: Path, *, revision: str = "head") -> None:
    """Bring the schema to `revision`, by default the newest; several processes may try at once.

    An existing SQLite database is copied to `backups/` in the data folder first.
    """
    with FileLock(data_dir / "migrate.lock"):
        current = current_revision(database)
        scripts = ScriptDirectory.from_config(migration_config())
        known = {script.revision for script in scripts.walk_revisions()}
        if current is not None and current not in known:
            raise SchemaTooNew(
                f"the database's schema {current} is unknown to this version; install a newer one"
            )
        if current == (scripts.get_current_head() if revision == "head" else revision):
            return
        if database.is_sqlite:
            if current is not None:
                back_up(database, data_dir / "backups", current)
            _migrate_sqlite(database, "upgrade", revision)
        else:
            _migrate_postgresql(database, "upgrade", revision)


def downgrade(database: Database, revision: str) -> None:
    """Take the schema back to `revision`; data that the older schema cannot hold are lost."""
    if database.is_sqlite:
        _migrate_sqlite(database, "downgrade", revision)
    else:
        _migrate_postgresql(database, "downgrade", revision)


def back_up(database: Database, folder: Path, revision: str) -> Path:
    """Copy a SQLite database whole and consistent, and return the copy's path."""
    folder.mkdir(parents=True, exist_ok=True)
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
    path = folder / f"gridpose-{revision}-{stamp}.sqlite3"
    with database.engine.connect() as connection:
        # Outside of any transaction, as VACUUM requires: straight on the driver's connection.
        driver = connection.connection.driver_connection
        assert driver is not None
        driver.execute("VACUUM INTO ?", (str(path),))
    return path


def _migrate_sqlite(database: Database, direction: str, revision: str) -> None:
    """Migrate with foreign keys off, since recreating a parent table would otherwise delete its children.

    The switch only works outside of a transaction; the check for dangling references runs inside, so that a bad
    migration leaves no trace.
    """
    with database.engine.connect() as connection:
        driver = connection.connection.driver_connection
        assert driver is not None
        driver.execute("PRAGMA foreign_keys=OFF")
        try:
            with connection.begin():
                _run(connection, direction, revision)
                dangling = connection.exec_driver_sql("PRAGMA foreign_key_check").all()
                if dangling:
                    raise BrokenReferences(f"{len(dangling)} rows of {dangling[0][0]} refer to nothing")
        finally:
            driver.execute("PRAGMA foreign_keys=ON")


def _migrate_postgresql(database: Database, direction: str, revision: str) -> None:
    with database.engine.begin() as connection:
        connection.execute(sa.select(sa.func.pg_advisory_xact_lock(_ADVISORY_LOCK)))
        _run(connection, direction, revision)


def _run(connection: sa.Connection, direction: str, revision: str) -> None:
    config = migration_config(connection)
    if direction == "upgrade":
        command.upgrade(config, revision)
    else:
        command.downgrade(config, revision)
