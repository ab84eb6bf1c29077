"""The base of all tables, and their types, none of whose stored values makes reading a row raise.

Ids are time-ordered text (`ids.new_id`), so that "oldest first" is the order of the primary key. Documents that are
only ever read whole are JSON; arrays of a result are bytes (`codec` knows the layout).
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

from app.records.activity import maker
from app.records.ids import is_id
from app.records.readable import Unreadable, read_or_mark

STATUSES = ("queued", "running", "succeeded", "failed")
SCOPES = ("read", "ingest", "upload", "admin")
JsonList = list[Any]
JsonObject = dict[str, Any]


class _Readable(sa.types.TypeDecorator[Any]):
    """A type whose stored values never make a query raise: what cannot be read is an `Unreadable` (`readable`)."""

    def result_processor(self, dialect: sa.Dialect, coltype: object) -> Callable[[Any], Any] | None:
        read = super().result_processor(dialect, coltype)
        return None if read is None else partial(read_or_mark, read)


class UtcDateTime(_Readable):
    """An aware time in UTC; SQLite, which has no time zones, stores it naive."""

    impl = sa.DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        if value is None:
            return None
        value = value.astimezone(UTC)
        return value.replace(tzinfo=None) if dialect.name == "sqlite" else value

    def process_result_value(
        self, value: datetime | Unreadable | None, dialect: sa.Dialect
    ) -> datetime | Unreadable | None:
        if value is None or isinstance(value, Unreadable):
            return value
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Bytes(_Readable):
    """An array's bytes."""

    impl = sa.LargeBinary()
    cache_ok = True


class Table(DeclarativeBase):
    """Base of all tables; the naming convention lets batch migrations find every constraint."""

    metadata = sa.MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "ck": "ck_%(table_name)s_%(constraint_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map = {  # noqa: RUF012 - SQLAlchemy's own declaration
        datetime: UtcDateTime(),
        JsonList: sa.JSON(none_as_null=True),
        JsonObject: sa.JSON(none_as_null=True),
    }


def made_by_column() -> Mapped[str | None]:
    """Return the column that holds who made a row (`activity.maker`); rows older than it have null."""
    return mapped_column(sa.String(40), default=maker)


def latest_ids(session: orm.Session) -> list[str]:
    """Return the greatest id of every table that has ids of ours."""
    latest = []
    for table in Table.metadata.sorted_tables:
        column = table.columns.get("id")
        if column is not None and column.primary_key and isinstance(column.type, sa.String):
            latest.append(session.scalar(sa.select(sa.func.max(column))))
    return [one for one in latest if one is not None and is_id(one)]
