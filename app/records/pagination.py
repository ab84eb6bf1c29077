"""Pages of a list, oldest first, by an opaque cursor that holds the last id seen."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import InvalidContent
from app.records.ids import is_id


def encode_cursor(last_id: str) -> str:
    """Return the cursor of the page that follows `last_id`."""
    return base64.urlsafe_b64encode(last_id.encode()).decode().rstrip("=")


def decode_cursor(cursor: str) -> str:
    """Return the id a cursor stands for; refuse what was never a cursor of ours."""
    try:
        last_id = base64.b64decode(cursor + "=" * (-len(cursor) % 4), altchars=b"-_", validate=True).decode(
            "ascii"
        )
    except (binascii.Error, ValueError):
        last_id = ""
    if not is_id(last_id):
        raise InvalidContent(
            "The cursor is not one this service gave out.",
            "Pass next_cursor of the page before, or leave cursor away.",
            code="invalid_cursor",
            errors=[("cursor", "is not a cursor of this list")],
        )
    return last_id


def page(
    session: orm.Session, statement: sa.Select[Any], id_column: Any, *, limit: int, cursor: str | None
) -> tuple[Sequence[Any], str | None]:
    """Return one page of `statement`'s rows and the cursor of the next, None at the end."""
    if cursor is not None:
        statement = statement.where(id_column > decode_cursor(cursor))
    rows = session.scalars(statement.order_by(id_column).limit(limit + 1)).all()
    if len(rows) <= limit:
        return rows, None
    rows = rows[:limit]
    return rows, encode_cursor(rows[-1].id)
