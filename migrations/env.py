"""Alembic's environment: runs on the connection `app.records.migrations` hands over."""

from __future__ import annotations

from alembic import context

from app.records.rows import is_of_queue
from app.records.tables import Table

connection = context.config.attributes.get("connection")
if connection is None:
    raise SystemExit(
        "migrations run through `gridpose` (app.records.migrations), which opens the right database"
    )


def _is_ours(_object: object, name: str | None, kind: str, reflected: bool, _compared: object) -> bool:
    """Ignore what exists on PostgreSQL alone, which is no table of records."""
    return not (kind == "table" and reflected and name is not None and is_of_queue(name))


context.configure(
    include_object=_is_ours,
    connection=connection,
    target_metadata=Table.metadata,
    render_as_batch=True,
    compare_type=True,
    # SQLite's transactions do cover DDL once the driver lets us say BEGIN ourselves, which it does here.
    transactional_ddl=True,
)
with context.begin_transaction():
    context.run_migrations()
