"""The latest change of each measurement's status, numbered by triggers, so that event streams can go on after it.

Measurements that changed before have no row, and nothing is written for them.

Revision: 0027, after 0026

A migration that makes `measurements` anew (batch mode on SQLite does) drops the table's triggers: it must call
`number_changes` again.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0027"
down_revision = "0026"
branch_labels = None
depends_on = None
lost_on_the_way_down = "Nothing: clients that follow a session begin with its counts anew."

# Microseconds since 1970, raised where the clock was set back: a number grows within its session, also where the row
# with the greatest one was deleted.
_ON_SQLITE = """
INSERT INTO measurement_changes (measurement_id, session_id, number)
VALUES (
    NEW.id,
    NEW.session_id,
    max(
        CAST((julianday('now') - 2440587.5) * 86400000 AS INTEGER) * 1000,
        1 + coalesce((SELECT max(number) FROM measurement_changes WHERE session_id = NEW.session_id), 0)
    )
)
ON CONFLICT (measurement_id) DO UPDATE SET number = excluded.number
"""
_SQLITE_TRIGGERS = {
    "measurement_changes_on_insert": "AFTER INSERT ON measurements",
    "measurement_changes_on_update": "AFTER UPDATE OF status ON measurements WHEN NEW.status <> OLD.status",
}

# Transactions commit in another order than they number. Each holds a lock whose key is the time of its first change
# until it has ended, which others read from pg_locks: its numbers are not less. Other advisory locks of this database
# have small keys. One lock for each transaction, since the server has room for a few thousand.
_MOMENT = """
CREATE FUNCTION moment_of_change() RETURNS bigint LANGUAGE plpgsql AS $$
BEGIN
    IF coalesce(current_setting('gridpose.numbers_changes', true), '') = '' THEN
        PERFORM pg_advisory_xact_lock_shared(CAST(extract(epoch FROM clock_timestamp()) * 1000000 AS bigint));
        PERFORM set_config('gridpose.numbers_changes', 'yes', true);
    END IF;
    RETURN CAST(extract(epoch FROM clock_timestamp()) * 1000000 AS bigint);
END $$
"""
_NUMBER = """
    moment := moment_of_change();
    INSERT INTO measurement_changes (measurement_id, session_id, number)
        SELECT one.id, one.session_id, greatest(moment, 1 + coalesce(latest.number, 0))
        FROM (SELECT DISTINCT session_id FROM written) AS session
        CROSS JOIN LATERAL (
            SELECT max(number) AS number FROM measurement_changes AS known
            WHERE known.session_id = session.session_id
        ) AS latest
        JOIN written AS one ON one.session_id = session.session_id
"""
_ON_INSERT = f"""
CREATE FUNCTION measurement_changes_on_insert() RETURNS trigger LANGUAGE plpgsql AS $$
DECLARE
    moment bigint;
BEGIN
    IF NOT EXISTS (SELECT FROM written) THEN RETURN NULL; END IF;
    {_NUMBER};
    RETURN NULL;
END $$
"""
_ON_UPDATE = f"""
CREATE FUNCTION measurement_changes_on_update() RETURNS trigger LANGUAGE plpgsql AS $$
DECLARE
    moment bigint;
    changed text[] := ARRAY(
        SELECT written.id FROM written JOIN former USING (id) WHERE written.status <> former.status
    );
BEGIN
    IF cardinality(changed) = 0 THEN RETURN NULL; END IF;
    {_NUMBER} WHERE one.id = ANY(changed)
        ON CONFLICT (measurement_id) DO UPDATE SET number = excluded.number;
    RETURN NULL;
END $$
"""  # noqa: S608 - of constants
_POSTGRESQL_TRIGGERS = {
    "measurement_changes_on_insert": "AFTER INSERT ON measurements REFERENCING NEW TABLE AS written",
    "measurement_changes_on_update": "AFTER UPDATE ON measurements "
    "REFERENCING OLD TABLE AS former NEW TABLE AS written",
}


def _is_sqlite() -> bool:
    return op.get_bind().dialect.name == "sqlite"


def upgrade() -> None:
    op.create_table(
        "measurement_changes",
        sa.Column("measurement_id", sa.String(length=40), nullable=False),
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("number", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(
            ["measurement_id"],
            ["measurements.id"],
            name=op.f("fk_measurement_changes_measurement_id_measurements"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("measurement_id", name=op.f("pk_measurement_changes")),
        sqlite_with_rowid=False,
    )
    op.create_index(
        "ix_measurement_changes_session_id_number_measurement_id",
        "measurement_changes",
        ["session_id", "number", "measurement_id"],
    )
    if not _is_sqlite():
        for function in (_MOMENT, _ON_INSERT, _ON_UPDATE):
            op.execute(sa.text(function))
    number_changes()


def downgrade() -> None:
    for name in _SQLITE_TRIGGERS:
        if _is_sqlite():
            op.execute(f"DROP TRIGGER {name}")
        else:
            op.execute(f"DROP TRIGGER {name} ON measurements")
            op.execute(f"DROP FUNCTION {name}()")
    if not _is_sqlite():
        op.execute("DROP FUNCTION moment_of_change()")
    op.drop_table("measurement_changes")


def number_changes() -> None:
    """Make the triggers."""
    if _is_sqlite():
        for name, event in _SQLITE_TRIGGERS.items():
            op.execute(f"CREATE TRIGGER {name} {event} BEGIN {_ON_SQLITE}; END")
    else:
        for name, event in _POSTGRESQL_TRIGGERS.items():
            op.execute(f"CREATE TRIGGER {name} {event} FOR EACH STATEMENT EXECUTE FUNCTION {name}()")
