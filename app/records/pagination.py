"""Pages of a list, oldest first, by an opaque cursor: the last id seen, and which list it was seen in."""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm
from sqlalchemy.sql import visitors

from app.errors import InvalidContent
from app.records.ids import is_id

_NAME_BYTES = 4
"""Enough against mistakes; a cursor is no secret, and what it may show is checked like every other page."""


def page(
    session: orm.Session, statement: sa.Select[Any], id_column: Any, *, limit: int, cursor: str | None
) -> tuple[Sequence[Any], str | None]:
    """Return one page of `statement`'s rows and the cursor of the next, None at the end.

    Raises InvalidContent (`invalid_cursor`) for a cursor of another list: of other rows, or with other filters.
    """
    of_list = _list_name(statement, id_column)
    if cursor is not None:
        statement = statement.where(id_column > _last_id(cursor, of_list))
    rows = session.scalars(statement.order_by(id_column).limit(limit + 1)).all()
    if len(rows) <= limit:
        return rows, None
    rows = rows[:limit]
    return rows, _encode(f"{rows[-1].id} {of_list}")


def _list_name(statement: sa.Select[Any], id_column: Any) -> str:
    """Return a short name of a list: its table, and the ids and words that it is filtered by, but no times."""
    criteria = () if statement.whereclause is None else visitors.iterate(statement.whereclause)
    named: list[object] = []
    for each in criteria:
        if isinstance(each, sa.Column):
            named.append(each.key)
        elif isinstance(each, sa.BindParameter) and isinstance(each.value, str | list | tuple):
            named.append(each.value)
    content = repr([id_column.class_.__tablename__, *named]).encode()
    return hashlib.blake2s(content, digest_size=_NAME_BYTES).hexdigest()


def _encode(text: str) -> str:
    return base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")


def _last_id(cursor: str, of_list: str) -> str:
    """Return the id that a cursor of this list holds; refuse every other."""
    try:
        text = base64.b64decode(cursor + "=" * (-len(cursor) % 4), altchars=b"-_", validate=True).decode(
            "ascii"
        )
    except (binascii.Error, ValueError):
        text = ""
    last_id, _, named = text.partition(" ")
    if not is_id(last_id) or named != of_list:
        raise InvalidContent(
            "The cursor is not one of this list.",
            "Pass next_cursor of the page before with the same filters, or leave cursor away.",
            code="invalid_cursor",
            errors=[("cursor", "is not a cursor of this list")],
        )
    return last_id
