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

# Microseconds since 1970, raised where the clock was set back: a number is more than all that its session has. Where
# the clock was set back and the row with the greatest number was deleted, too, followers miss events until the clock
# has come to that number again; their counts are right.
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
# For each row, not for each statement: a connection keeps the plan of its first call, which is made for one row, and a
# join of the rows of a statement with those of before then takes the square of their number.
_ON_POSTGRESQL = """
CREATE FUNCTION number_change() RETURNS trigger LANGUAGE plpgsql AS $$
DECLARE
    moment bigint := moment_of_change();
BEGIN
    INSERT INTO measurement_changes (measurement_id, session_id, number)
        VALUES (
            NEW.id,
            NEW.session_id,
            greatest(
                moment,
                1 + coalesce((SELECT max(number) FROM measurement_changes WHERE session_id = NEW.session_id), 0)
            )
        )
        ON CONFLICT (measurement_id) DO UPDATE SET number = excluded.number;
    RETURN NULL;
END $$
"""
_TRIGGERS = {
    "measurement_changes_on_insert": "AFTER INSERT ON measurements {each}",
    "measurement_changes_on_update": "AFTER UPDATE OF status ON measurements {each} WHEN (NEW.status <> OLD.status)",
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
        for function in (_MOMENT, _ON_POSTGRESQL):
            op.execute(sa.text(function))
    number_changes()


def downgrade() -> None:
    for name in _TRIGGERS:
        op.execute(f"DROP TRIGGER {name}" if _is_sqlite() else f"DROP TRIGGER {name} ON measurements")
    if not _is_sqlite():
        op.execute("DROP FUNCTION number_change()")
        op.execute("DROP FUNCTION moment_of_change()")
    op.drop_table("measurement_changes")


def number_changes() -> None:
    """Make the triggers."""
    for name, event in _TRIGGERS.items():
        if _is_sqlite():
            op.execute(f"CREATE TRIGGER {name} {event.format(each='')} BEGIN {_ON_SQLITE}; END")
        else:
            each = "FOR EACH ROW"
            op.execute(f"CREATE TRIGGER {name} {event.format(each=each)} EXECUTE FUNCTION number_change()")
