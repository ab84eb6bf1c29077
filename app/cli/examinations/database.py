"""Whether the database opens, is whole and has this version's schema, and the clock agrees with it."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import sqlalchemy as sa
from alembic.script import ScriptDirectory
from sqlalchemy.exc import DBAPIError

from app.cli.findings import Finding, failed, ok, warn
from app.errors import ServiceError
from app.records.database import Database
from app.records.schema import current_revision, head_revision, migration_config
from app.records.tables import ApiKey, Measurement
from app.settings import Settings

_CLOCK_SLACK = timedelta(minutes=5)


def examine(settings: Settings) -> Iterator[Finding]:
    url = sa.make_url(settings.effective_database_url)
    if url.get_backend_name() == "sqlite" and not (settings.data_dir / "gridpose.sqlite3").exists():
        yield ok("is not there yet; the first start makes it")
        return
    database = Database(settings.effective_database_url)
    try:
        yield from _examine(database)
    except DBAPIError as error:
        reason = str(error.orig).strip().splitlines()
        yield failed(
            f"cannot be used: {reason[0] if reason else type(error.orig).__name__}",
            "See that the server runs and GRIDPOSE_DATABASE_URL is right; restore a damaged SQLite file from "
            "backups/ in the data folder.",
        )
    except ServiceError as error:
        yield failed(error.detail, "See that nothing else holds the database, and that its disk has room.")
    finally:
        database.dispose()


def _examine(database: Database) -> Iterator[Finding]:
    current, head = current_revision(database), head_revision()
    with database.read() as session:  # a reader: the service's writers do not wait for it
        if database.is_sqlite:
            yield ok(f"SQLite, {session.scalar(sa.text('PRAGMA journal_mode'))} mode")
            answer = session.scalar(sa.text("PRAGMA quick_check(1)"))
            if answer != "ok":
                yield failed(
                    f"is damaged: {answer}", "Stop the service; restore the newest file of backups/."
                )
                return
            yield ok("is whole (quick_check)")
        else:
            yield ok(f"PostgreSQL {session.scalar(sa.text('SHOW server_version'))}")
        if current != head:
            yield _schema(current, head)
            return
        yield ok(f"schema {current} is current")
        keys = session.scalar(sa.select(sa.func.count()).where(ApiKey.revoked_at.is_(None)))
        if keys:
            yield ok(f"API keys in use: {keys}")
        else:
            yield warn("there is no API key", "Make one: gridpose keys create NAME --scope admin")
        yield _clock(session.scalar(sa.select(sa.func.max(Measurement.received_at))))


def _clock(newest: datetime | None) -> Finding:
    now = datetime.now(UTC)
    if newest is not None and newest > now + _CLOCK_SLACK:
        return warn(
            f"the clock, {now:%Y-%m-%d %H:%M} UTC, is behind the newest image, {newest:%Y-%m-%d %H:%M}",
            "Set the clock, best by NTP; lists are ordered by time of arrival.",
        )
    return ok(f"the clock, {now:%Y-%m-%d %H:%M} UTC, is not behind the newest image")


def _schema(current: str | None, head: str) -> Finding:
    if current is not None and current not in _known_revisions():
        return failed(
            f"schema {current} was made by a later version", "Install that version, or restore a backup."
        )
    return warn(
        f"schema {current or 'none'} is older than {head}, which this version needs",
        "The next start migrates it and keeps a copy in backups/; nothing else to do.",
    )


def _known_revisions() -> set[str]:
    return {script.revision for script in ScriptDirectory.from_config(migration_config()).walk_revisions()}
