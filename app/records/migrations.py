"""The schema's version: what the database has, what this program needs, and the way from one to the other."""

from __future__ import annotations

import importlib.util
import os
import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory

from app.records.database import Database, map_database_errors
from app.records.file_lock import FileLock
from app.records.rows import copy_rows

_ADVISORY_LOCK = 0x6772_6964  # "grid": migrations on PostgreSQL exclude one another
KEPT_COPIES = 3
"""Copies from before a change of the schema that stay in `backups/`."""


class SchemaTooNew(Exception):
    """The database was made by a later version of this program."""


class NoRoomForCopy(Exception):
    """The disk has no room for the copy that is made before a schema is changed."""


class NotOnTheWayDown(Exception):
    """A schema can only be taken back to an earlier one."""


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
    config.set_main_option("recursive_version_locations", "true")  # ten revisions a folder
    config.attributes["connection"] = connection
    return config


def _scripts() -> ScriptDirectory:
    location = migration_config().get_main_option("script_location")
    assert location is not None, "`migration_config` sets it"
    return _scripts_of(location)


@cache
def _scripts_of(location: str) -> ScriptDirectory:
    """Return the migrations in a folder. They are compiled when they are first looked at, which takes 20 ms."""
    return ScriptDirectory.from_config(migration_config())


def head_revision() -> str:
    """Return the schema version this program needs."""
    head = _scripts().get_current_head()
    assert head is not None, "there is always a first migration"
    return head


def known_revisions() -> set[str]:
    """Return every schema version this program has a migration to."""
    return {script.revision for script in _scripts().walk_revisions()}


def current_revision(database: Database) -> str | None:
    """Return the database's schema version; None when it is empty."""
    with database.engine.connect() as connection:
        return MigrationContext.configure(connection).get_current_revision()


def upgrade(
    database: Database,
    data_dir: Path,
    *,
    revision: str = "head",
    copy_first: bool = True,
    alone: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> None:
    """Bring the schema to `revision`, by default the newest; several processes may try at once.

    An existing database is changed within `alone()`, which raises where others use it, and is copied to `backups/` in
    the data folder first, with `copy_first`. Raises SchemaTooNew, NoRoomForCopy.
    """
    with FileLock(data_dir / "migrate.lock"):
        current = current_revision(database)
        require_known(current)
        if current == (head_revision() if revision == "head" else revision):
            return
        with nullcontext() if current is None else alone():
            if current is not None and copy_first:
                back_up(database, data_dir / "backups", current)
            _migrate(database, "upgrade", revision)


def require_known(revision: str | None) -> None:
    """Raise SchemaTooNew where this program does not know a database's revision."""
    if revision is not None and revision not in known_revisions():
        raise SchemaTooNew(
            f"the database's schema {revision} is unknown to this version; install a newer one"
        )


def downgrade(database: Database, revision: str) -> None:
    """Take the schema back to `revision`; data that the older schema cannot hold are lost (`what_is_lost`)."""
    _migrate(database, "downgrade", revision)


def what_is_lost(current: str, revision: str) -> list[tuple[str, str]]:
    """Return, for each step of the way down from `current` to `revision`, its revision and what it loses.

    Raises NotOnTheWayDown where `revision` is not an earlier one.
    """
    way = [script for script in _scripts().walk_revisions() if script.revision is not None]
    names = [script.revision for script in way]
    if current not in names or revision not in names[names.index(current) + 1 :]:
        raise NotOnTheWayDown(f"schema {revision} is not an earlier one than {current}")
    steps = way[names.index(current) : names.index(revision)]
    return [(script.revision, script.module.lost_on_the_way_down) for script in steps]


def earlier_revisions(current: str | None) -> list[tuple[str, str]]:
    """Return the revisions a database at `current` can be taken back to, newest first, each with its subject."""
    way = [(script.revision, script.doc) for script in _scripts().walk_revisions()]
    names = [name for name, _ in way]
    return way[names.index(current) + 1 :] if current in names else []


def back_up(database: Database, folder: Path, revision: str) -> Path:
    """Copy a database whole and consistent to a SQLite file in `folder` and return its path.

    Only the newest KEPT_COPIES stay in the folder. The caller holds `migrate.lock`. Raises NoRoomForCopy.
    """
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    for unfinished in folder.glob("gridpose-*.sqlite3.partial*"):  # a process that was killed left it
        unfinished.unlink(missing_ok=True)
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
    path = folder / f"gridpose-{revision}-{stamp}.sqlite3"
    copy_to_file(database, path)
    copies = sorted(folder.glob("gridpose-*-*.sqlite3"), key=lambda copy: copy.stem.rpartition("-")[2])
    for copy in copies[:-KEPT_COPIES]:
        copy.unlink(missing_ok=True)
    return path


def copy_to_file(database: Database, path: Path) -> None:
    """Write one moment of a database to a new SQLite file of the same schema, durably, while others write to it.

    Raises NoRoomForCopy; where it fails nothing is left under the path.
    """
    with map_database_errors(database.damage):
        needed, free = database.size_bytes(), shutil.disk_usage(path.parent).free
    if free < needed:
        raise NoRoomForCopy(
            f"a copy of the database takes {needed} bytes, and {free} are free in {path.parent}"
        )
    partial = path.with_name(path.name + ".partial")
    try:
        if database.is_sqlite:
            # Errors of the driver itself are no errors of SQLAlchemy.
            with map_database_errors(database.damage), database.engine.connect() as connection:
                # Outside of any transaction, as VACUUM requires: straight on the driver's connection.
                driver = connection.connection.driver_connection
                assert driver is not None
                driver.execute("VACUUM INTO ?", (str(partial),))
        else:
            _copy_postgresql(database, partial)
        partial.chmod(0o600)
        with partial.open("rb+") as file:
            os.fsync(file.fileno())
        partial.replace(path)
    finally:
        for left in (
            partial,
            partial.with_name(partial.name + "-wal"),
            partial.with_name(partial.name + "-shm"),
        ):
            left.unlink(missing_ok=True)


def _copy_postgresql(database: Database, path: Path) -> None:
    snapshot = database.engine.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
    copy = Database(sa.URL.create("sqlite", database=str(path)))
    try:
        with snapshot.connect() as source, source.begin():
            revision = MigrationContext.configure(source).get_current_revision()
            assert revision is not None, "an empty database is not copied"
            _migrate(copy, "upgrade", revision)
            with copy.engine.begin() as target:
                copy_rows(source, target)
    finally:
        copy.dispose()


def _migrate(database: Database, direction: str, revision: str) -> None:
    if database.is_sqlite:
        _migrate_sqlite(database, direction, revision)
    else:
        _migrate_postgresql(database, direction, revision)


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
        connection.execute(
            sa.text("SET LOCAL lock_timeout = 0")
        )  # another may migrate for as long as it takes
        connection.execute(sa.select(sa.func.pg_advisory_xact_lock(_ADVISORY_LOCK)))
        _run(connection, direction, revision)


def _run(connection: sa.Connection, direction: str, revision: str) -> None:
    config = migration_config(connection)
    if direction == "upgrade":
        command.upgrade(config, revision)
    else:
        command.downgrade(config, revision)
