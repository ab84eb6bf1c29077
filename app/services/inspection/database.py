"""Checks of the database: it opens, is intact, has this version's schema, and its times are not in the future.

The deep checks read every page and row.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import sqlalchemy as sa
from sqlalchemy import orm
from sqlalchemy.exc import DBAPIError

from app.errors import InstallationRefused, ServiceError
from app.records.database import Database, is_damage
from app.records.migrations import current_revision, head_revision, known_revisions
from app.records.readable import Unreadable
from app.records.tables import ApiKey, Measurement, Table
from app.services.backup import damage_advice
from app.services.inspection import files
from app.services.inspection.check_result import CheckResult, failed, ok, warn
from app.services.installation.backends import clock_skew, require_clock, require_direct
from app.settings import Settings

_MAX_CLOCK_LAG = timedelta(minutes=5)
_SQLITE_UNUSABLE = (
    "Check that gridpose.sqlite3 belongs to the user the service runs as (chown), and that its disk is mounted, "
    "writable and has free space."
)
_NO_SERVER = "Check that the server runs and GRIDPOSE_DATABASE_URL is right."
_LOCKED = "Check that nothing else locks the database, and that its disk has free space."
_MAX_LISTED = 20
_FREE_CONNECTIONS = 42
"""What one more service takes."""


def check(settings: Settings, *, whole: bool = True, deep: bool = False) -> Iterator[CheckResult]:
    """Check the database; `whole`: that its file is intact, which reads all of it; `deep`: every row, too."""
    url = sa.make_url(settings.effective_database_url)
    if url.get_backend_name() == "sqlite" and not (settings.data_dir / "gridpose.sqlite3").exists():
        yield ok("does not exist yet; the first start creates it")
        return
    if url.get_backend_name() == "sqlite" and files.is_read_only(settings.data_dir):
        yield warn("not checked: its disk is read-only", "See the checks of the data folder.")
        return
    database = Database(settings.effective_database_url)
    try:
        yield from _check(settings, database, whole=whole, deep=deep)
    except DBAPIError as error:
        reason = (str(error.orig).strip().splitlines() or [type(error.orig).__name__])[0]
        if is_damage(error):
            yield failed(f"is damaged: {reason}", damage_advice(settings))
        else:
            yield failed(f"cannot be used: {reason}", _SQLITE_UNUSABLE if database.is_sqlite else _NO_SERVER)
    except ServiceError as error:
        damaged = error.code == "database_damaged"
        yield failed(error.detail, damage_advice(settings) if damaged else _LOCKED)
    finally:
        database.dispose()


def _check(settings: Settings, database: Database, *, whole: bool, deep: bool) -> Iterator[CheckResult]:
    keys_off = settings.auth == "off"
    current, head = current_revision(database), head_revision()
    with database.read() as session:  # a reader: it does not block the service's writers
        if database.is_sqlite:
            yield ok(f"SQLite, {session.scalar(sa.text('PRAGMA journal_mode'))} mode")
            if whole:
                answer = session.scalar(sa.text("PRAGMA quick_check(1)"))
                if answer != "ok":
                    yield failed(f"is damaged: {answer}", damage_advice(settings))
                    return
                yield ok("is intact (quick_check)")
        else:
            yield from _server(database, session)
        if current != head:
            yield _schema(current, head)
            return
        yield ok(f"schema {current} is current")
        if deep:
            yield from check_deep(database, session, damage_advice(settings))
        yield ok("keys are off (GRIDPOSE_AUTH)") if keys_off else _keys(session)
        yield _clock(session.scalar(sa.select(sa.func.max(Measurement.received_at))))


def _server(database: Database, session: orm.Session) -> Iterator[CheckResult]:
    """Check what services and workers need of a PostgreSQL server."""
    yield ok(f"PostgreSQL {session.scalar(sa.text('SHOW server_version'))}")
    try:
        require_direct(database)
        yield ok("is reached without a pooler, or through one that keeps sessions")
        require_clock(database)
        yield ok(f"and this machine's clock agree within {abs(clock_skew(database).total_seconds()):.1f} s")
    except InstallationRefused as error:
        yield failed(error.detail, error.advice)
    used, most = session.execute(
        sa.text("SELECT (SELECT count(*) FROM pg_stat_activity), current_setting('max_connections')::int")
    ).one()
    if most - used < _FREE_CONNECTIONS:
        yield warn(
            f"{used} of {most} connections are in use",
            "Raise max_connections: docs/scale.md says how many a service and a worker take.",
        )
    else:
        yield ok(f"{used} of {most} connections are in use")


def _keys(session: orm.Session) -> CheckResult:
    lasting = sa.or_(ApiKey.expires_at.is_(None), ApiKey.expires_at > datetime.now(UTC))
    scopes = session.scalars(sa.select(ApiKey.scope).where(ApiKey.revoked_at.is_(None), lasting)).all()
    if "admin" in scopes:
        return ok(f"API keys in force: {len(scopes)}")
    found = "no API key in force has the scope admin" if scopes else "there is no API key in force"
    return warn(found, "Create one: gridpose keys create NAME --scope admin")


def _clock(newest: datetime | Unreadable | None) -> CheckResult:
    now = datetime.now(UTC)
    if isinstance(newest, Unreadable):
        return failed(
            "a measurement's time of arrival cannot be read",
            "Look for measurements with the failure row_unreadable; restore a backup.",
        )
    if newest is not None and newest > now + _MAX_CLOCK_LAG:
        return warn(
            f"the clock, {now:%Y-%m-%d %H:%M} UTC, is behind the newest image, {newest:%Y-%m-%d %H:%M}",
            "Set the clock, best by NTP. If it is right now, it was ahead when that image came: nothing is to be done.",
        )
    return ok(f"the clock, {now:%Y-%m-%d %H:%M} UTC, is not behind the newest image")


def _schema(current: str | None, head: str) -> CheckResult:
    if current is not None and current not in known_revisions():
        return failed(
            f"schema {current} was made by a later version", "Install that version, or restore a backup."
        )
    return warn(
        f"schema {current or 'none'} is older than {head}, which this version needs",
        "The next start migrates it and keeps a copy in backups/; nothing to do.",
    )


def check_deep(database: Database, session: orm.Session, advice: str) -> Iterator[CheckResult]:
    """Read every page and row within `session`, a reader: the service keeps running. `advice` is for damage."""
    if database.is_sqlite:
        yield from _sqlite(session, advice)
    else:
        yield from _postgresql(session, advice)
    yield from _references(session, advice)


def _sqlite(session: orm.Session, advice: str) -> Iterator[CheckResult]:
    answers = session.scalars(sa.text(f"PRAGMA integrity_check({_MAX_LISTED})")).all()
    if answers == ["ok"]:
        yield ok("is intact in every page and index (integrity_check)")
    for answer in answers if answers != ["ok"] else ():
        yield failed(f"is damaged: {answer}", advice)
    dangling = session.execute(sa.text("PRAGMA foreign_key_check")).fetchmany(_MAX_LISTED)
    for table, row, parent, _ in dangling:
        yield failed(f"row {row} of {table} refers to nothing in {parent} (foreign_key_check)", advice)
    if not dangling:
        yield ok("no row refers to nothing (foreign_key_check)")


def _postgresql(session: orm.Session, advice: str) -> Iterator[CheckResult]:
    """Read every value of every row, which reveals damaged pages and lost large values; query the page checksums."""
    for table in Table.metadata.sorted_tables:
        try:
            with session.begin_nested():
                whole_row = sa.cast(sa.literal_column(table.name), sa.Text)
                session.execute(sa.select(sa.func.count(sa.func.md5(whole_row))).select_from(table)).one()
        except DBAPIError as error:
            reason = str(error.orig).strip().splitlines()[0]
            yield failed(f"table {table.name} cannot be read completely: {reason}", advice)
    if session.scalar(sa.text("SHOW data_checksums")) != "on":
        yield warn(
            "the server keeps no checksums of its pages, so that damage on its disk is detected late",
            "Have its administrator run `pg_checksums --enable` while it is stopped.",
        )
        return
    damaged = session.scalar(
        sa.text("SELECT checksum_failures FROM pg_stat_database WHERE datname = current_database()")
    )
    if damaged:
        yield failed(f"the server counted {damaged} pages with wrong checksums", advice)
    else:
        yield ok("the server found no page with a wrong checksum")


def _references(session: orm.Session, advice: str) -> Iterator[CheckResult]:
    """Count rows whose reference has no target row, by the foreign keys of this version's tables."""
    dangling = 0
    for table in Table.metadata.sorted_tables:
        for constraint in table.foreign_key_constraints:
            parent = constraint.referred_table.alias()
            pairs = [(element.parent, parent.c[element.column.name]) for element in constraint.elements]
            count = session.scalar(
                sa.select(sa.func.count())
                .select_from(table)
                .where(
                    *(own.is_not(None) for own, _ in pairs),
                    ~sa.exists().select_from(parent).where(*(theirs == own for own, theirs in pairs)),
                )
            )
            if count:
                dangling += count
                yield failed(
                    f"{count} rows of {table.name} refer to nothing in {constraint.referred_table.name}",
                    advice,
                )
    if not dangling:
        yield ok("every row was read, and what it refers to is there")
