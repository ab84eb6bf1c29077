"""Stored JSON documents rewritten by a revision."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import sqlalchemy as sa
from alembic import op

_BATCH = 500


def rewrite_documents(table: str, key: str, column: str, rewritten: Callable[[Any], Any]) -> None:
    """Replace a column's documents, a batch of rows at a time.

    Parameters
    ----------
    key
        The column that identifies a row.
    rewritten
        Returns the new document; None for one that stays as it is. It is given None for what is no JSON.
    """
    rows = sa.table(table, sa.column(key, sa.String), sa.column(column))
    connection = op.get_bind()
    last = ""
    while found := connection.execute(
        sa.select(rows.c[key], rows.c[column])
        .where(rows.c[key] > last, rows.c[column].is_not(None))
        .order_by(rows.c[key])
        .limit(_BATCH)
    ).all():
        documents = [{"row": row, "document": rewritten(_read(stored))} for row, stored in found]
        if sound := [one for one in documents if one["document"] is not None]:
            connection.execute(
                sa.update(rows)
                .where(rows.c[key] == sa.bindparam("row"))
                .values({column: sa.bindparam("document", type_=sa.JSON())}),
                sound,
            )
        last = found[-1][0]


def _read(stored: Any) -> Any:
    """Return a document, which SQLite hands over as text; None for what is no JSON."""
    if not isinstance(stored, str | bytes):
        return stored
    try:
        return json.loads(stored)
    except ValueError:
        return None
