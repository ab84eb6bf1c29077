"""Records of qualifications by known lengths.

Revision: 0022, after 0021
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None
lost_on_the_way_down = (
    "All records of qualifications. Save them first (`gridpose qualifications list`, "
    "GET /v1/qualifications/{id})."
)

_REFUSAL = "qualifications are never changed or deleted"


def upgrade() -> None:
    op.create_table(
        "qualifications",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("session_name", sa.String(length=200), nullable=False),
        sa.Column("robot_id", sa.String(length=40), nullable=True),
        sa.Column("camera_name", sa.String(length=200), nullable=True),
        sa.Column("made_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("due_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("decision", sa.String(length=16), nullable=True),
        sa.Column("maximum_permissible_error_mm", sa.Double(), nullable=True),
        sa.Column("worst_error_mm", sa.Double(), nullable=False),
        sa.Column("probing_scatter_mm", sa.Double(), nullable=True),
        sa.Column("scale_ppm", sa.Double(), nullable=False),
        sa.Column("analysis", sa.JSON(), nullable=False),
        sa.Column("made_by", sa.String(length=40), nullable=True),
        sa.Column("made_by_name", sa.String(length=200), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_qualifications")),
    )
    op.create_index("ix_qualifications_robot_id_id", "qualifications", ["robot_id", "id"])
    op.create_index("ix_qualifications_session_id", "qualifications", ["session_id"])
    _forbid_changes()


def downgrade() -> None:
    op.drop_table("qualifications")
    if op.get_bind().dialect.name != "sqlite":
        op.execute("DROP FUNCTION refuse_qualification_change()")


def _forbid_changes() -> None:
    """Keep records as they are, whatever program writes; a migration that remakes the table calls this again."""
    if op.get_bind().dialect.name == "sqlite":
        for change in ("UPDATE", "DELETE"):
            op.execute(
                f"CREATE TRIGGER qualifications_no_{change.lower()} BEFORE {change} ON qualifications "
                f"BEGIN SELECT RAISE(ABORT, '{_REFUSAL}'); END"
            )
        return
    op.execute(
        "CREATE FUNCTION refuse_qualification_change() RETURNS trigger LANGUAGE plpgsql AS "
        f"$$ BEGIN RAISE EXCEPTION '{_REFUSAL}'; END $$"
    )
    op.execute(
        "CREATE TRIGGER qualifications_no_change BEFORE UPDATE OR DELETE ON qualifications "
        "FOR EACH ROW EXECUTE FUNCTION refuse_qualification_change()"
    )
