"""A version of keys and sessions, raised by triggers whoever changes them, so that they can be kept in memory.

Revision: 0018, after 0017

A migration that makes one of these tables anew (batch mode on SQLite does) drops the table's triggers: it must call
`count_changes` again.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None
lost_on_the_way_down = "Nothing."

_OF_KEYS = (
    "name",
    "scope",
    "secret_hmac",
    "created_at",
    "expires_at",
    "revoked_at",
    "session_ids",
    "bytes_per_day",
)
COUNTED = (
    # Neither the quota's use nor the time of use: they change with every upload.
    ("api_keys", f"UPDATE OF {', '.join(_OF_KEYS)}"),
    ("api_keys", "INSERT"),
    ("api_keys", "DELETE"),
    ("sessions", "DELETE"),
    ("session_targets", "INSERT"),
    ("session_targets", "UPDATE"),
    ("session_targets", "DELETE"),
)
_RAISE = (
    "INSERT INTO access_version (number, version) VALUES (1, 1) "
    "ON CONFLICT (number) DO UPDATE SET version = access_version.version + 1"
)


def _is_sqlite() -> bool:
    return op.get_bind().dialect.name == "sqlite"


def _name(table: str, change: str) -> str:
    return f"{table}_counted_on_{change.partition(' ')[0].lower()}"


def upgrade() -> None:
    op.create_table(
        "access_version",
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("version", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("number = 1", name=op.f("ck_access_version_one_row")),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_access_version")),
    )
    if not _is_sqlite():
        op.execute(
            "CREATE FUNCTION count_access_change() RETURNS trigger LANGUAGE plpgsql AS "
            f"$$ BEGIN {_RAISE}; RETURN NULL; END $$"
        )
    for table in dict.fromkeys(table for table, _ in COUNTED):
        count_changes(table)


def downgrade() -> None:
    for table, change in COUNTED:
        on = "" if _is_sqlite() else f" ON {table}"
        op.execute(f"DROP TRIGGER {_name(table, change)}{on}")
    if not _is_sqlite():
        op.execute("DROP FUNCTION count_access_change()")
    op.drop_table("access_version")


def count_changes(table: str) -> None:
    """Make the triggers of one table."""
    for name, change in COUNTED:
        if name != table:
            continue
        if _is_sqlite():
            op.execute(f"CREATE TRIGGER {_name(table, change)} AFTER {change} ON {table} BEGIN {_RAISE}; END")
        else:
            op.execute(
                f"CREATE TRIGGER {_name(table, change)} AFTER {change} ON {table} "
                "FOR EACH STATEMENT EXECUTE FUNCTION count_access_change()"
            )
