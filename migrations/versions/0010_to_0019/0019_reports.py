"""Stored reports of sessions, and their forms.

Revision: 0019, after 0018
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None
lost_on_the_way_down = "All stored reports, with their signatures. Save them first (`gridpose report fetch`)."

_REFUSAL = "finished reports are never changed or deleted"


def upgrade() -> None:
    op.create_table(
        "reports",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("title", sa.String(length=200), nullable=False),
        sa.Column("signatories", sa.JSON(), nullable=False),
        sa.Column("paper", sa.String(length=16), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("failure", sa.JSON(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("claimed_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("made_by", sa.String(length=40), nullable=True),
        sa.Column("made_by_name", sa.String(length=200), nullable=True),
        sa.Column("core_version", sa.String(length=64), nullable=True),
        sa.Column("inputs_sha256", sa.String(length=64), nullable=True),
        sa.Column("signature", sa.JSON(), nullable=True),
        sa.CheckConstraint(
            "status IN ('queued', 'running', 'succeeded', 'failed')", name=op.f("ck_reports_status")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_reports")),
    )
    op.create_index("ix_reports_session_id_id", "reports", ["session_id", "id"])
    op.create_index("ix_reports_status_id", "reports", ["status", "id"])
    op.create_table(
        "report_forms",
        sa.Column("report_id", sa.String(length=40), nullable=False),
        sa.Column("form", sa.String(length=16), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("bytes", sa.BigInteger(), nullable=False),
        sa.Column("content", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["report_id"], ["reports.id"], name=op.f("fk_report_forms_report_id_reports")
        ),
        sa.PrimaryKeyConstraint("report_id", "form", name=op.f("pk_report_forms")),
    )
    _forbid_changes()


def downgrade() -> None:
    op.drop_table("report_forms")
    op.drop_table("reports")
    if op.get_bind().dialect.name != "sqlite":
        op.execute("DROP FUNCTION refuse_report_change()")


def _forbid_changes() -> None:
    """Keep finished reports as they are, whatever program writes; a migration that remakes a table calls this again."""
    if op.get_bind().dialect.name == "sqlite":
        for change in ("UPDATE", "DELETE"):
            op.execute(
                f"CREATE TRIGGER reports_no_{change.lower()} BEFORE {change} ON reports "
                f"WHEN OLD.status = 'succeeded' BEGIN SELECT RAISE(ABORT, '{_REFUSAL}'); END"
            )
            op.execute(
                f"CREATE TRIGGER report_forms_no_{change.lower()} BEFORE {change} ON report_forms "
                f"BEGIN SELECT RAISE(ABORT, '{_REFUSAL}'); END"
            )
        return
    op.execute(
        "CREATE FUNCTION refuse_report_change() RETURNS trigger LANGUAGE plpgsql AS "
        f"$$ BEGIN RAISE EXCEPTION '{_REFUSAL}'; END $$"
    )
    op.execute(
        "CREATE TRIGGER reports_no_change BEFORE UPDATE OR DELETE ON reports "
        "FOR EACH ROW WHEN (OLD.status = 'succeeded') EXECUTE FUNCTION refuse_report_change()"
    )
    op.execute(
        "CREATE TRIGGER report_forms_no_change BEFORE UPDATE OR DELETE ON report_forms "
        "FOR EACH ROW EXECUTE FUNCTION refuse_report_change()"
    )
