"""The audit trail; keys limited to sessions, with a quota, that know when they were used; rows that know who made them.

Revision: 0007, after 0006
"""

from __future__ import annotations

from datetime import UTC, datetime

import sqlalchemy as sa
from alembic import op
from alembic.operations import BatchOperations

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None
lost_on_the_way_down = (
    "The audit trail; who made rows; quotas and times of use of keys. "
    "Keys of scope ingest and keys limited to sessions are revoked."
)

MADE = ("targets", "robots", "sessions", "measurements", "measured_poses")
_REFUSAL = "audit entries are never changed or deleted"


def _is_sqlite() -> bool:
    return op.get_bind().dialect.name == "sqlite"


def _replace_scopes(batch_op: BatchOperations, *scopes: str) -> None:
    listed = ", ".join(f"'{scope}'" for scope in scopes)
    batch_op.drop_constraint(op.f("ck_api_keys_scope"), type_="check")
    batch_op.create_check_constraint(op.f("ck_api_keys_scope"), f"scope IN ({listed})")


def upgrade() -> None:
    with op.batch_alter_table("api_keys") as batch_op:
        _replace_scopes(batch_op, "read", "ingest", "upload", "admin")
        batch_op.add_column(sa.Column("session_ids", sa.JSON(none_as_null=True), nullable=True))
        batch_op.add_column(sa.Column("bytes_per_day", sa.BigInteger(), nullable=True))
        batch_op.add_column(sa.Column("quota_day", sa.String(length=10), nullable=True))
        batch_op.add_column(sa.Column("quota_bytes", sa.BigInteger(), server_default="0", nullable=False))
        batch_op.add_column(sa.Column("last_used_at", sa.DateTime(timezone=True), nullable=True))
        batch_op.add_column(sa.Column("made_by", sa.String(length=40), nullable=True))
    for table in MADE:
        op.add_column(table, sa.Column("made_by", sa.String(length=40), nullable=True))
    op.create_table(
        "audit_entries",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("actor", sa.String(length=16), nullable=False),
        sa.Column("key_id", sa.String(length=40), nullable=True),
        sa.Column("key_name", sa.String(length=200), nullable=True),
        sa.Column("client", sa.String(length=64), nullable=True),
        sa.Column("action", sa.String(length=64), nullable=False),
        sa.Column("object_ids", sa.JSON(), nullable=False),
        sa.Column("request_id", sa.String(length=64), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit_entries")),
    )
    op.create_index("ix_audit_entries_key_id_id", "audit_entries", ["key_id", "id"])
    _forbid_changes()


def downgrade() -> None:
    op.drop_table("audit_entries")
    if not _is_sqlite():
        op.execute("DROP FUNCTION refuse_audit_change()")
    for table in MADE:
        op.drop_column(table, "made_by")
    # The older version knows no limits: a limited key would open everything to its holder.
    op.get_bind().execute(
        sa.text(
            "UPDATE api_keys SET scope = CASE WHEN scope = 'ingest' THEN 'read' ELSE scope END, "
            "revoked_at = COALESCE(revoked_at, :now) WHERE scope = 'ingest' OR session_ids IS NOT NULL"
        ).bindparams(sa.bindparam("now", type_=sa.DateTime(timezone=True))),
        {"now": datetime.now(UTC).replace(tzinfo=None) if _is_sqlite() else datetime.now(UTC)},
    )
    with op.batch_alter_table("api_keys") as batch_op:
        _replace_scopes(batch_op, "read", "upload", "admin")
        for column in ("made_by", "last_used_at", "quota_bytes", "quota_day", "bytes_per_day", "session_ids"):
            batch_op.drop_column(column)


def _forbid_changes() -> None:
    """Make entries append-only whatever program writes; a migration that makes the table anew must call this again."""
    if _is_sqlite():
        for change in ("UPDATE", "DELETE"):
            op.execute(
                f"CREATE TRIGGER audit_entries_no_{change.lower()} BEFORE {change} ON audit_entries "
                f"BEGIN SELECT RAISE(ABORT, '{_REFUSAL}'); END"
            )
        return
    op.execute(
        "CREATE FUNCTION refuse_audit_change() RETURNS trigger LANGUAGE plpgsql AS "
        f"$$ BEGIN RAISE EXCEPTION '{_REFUSAL}'; END $$"
    )
    op.execute(
        "CREATE TRIGGER audit_entries_no_change BEFORE UPDATE OR DELETE OR TRUNCATE ON audit_entries "
        "FOR EACH STATEMENT EXECUTE FUNCTION refuse_audit_change()"
    )
