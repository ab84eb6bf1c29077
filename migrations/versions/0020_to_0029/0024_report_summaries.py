"""What is compared of each report; the service takes it from reports that are there already.

Revision: 0024, after 0023
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0024"
down_revision = "0023"
branch_labels = None
depends_on = None
lost_on_the_way_down = "Nothing: what is compared of reports is taken from them again."


def upgrade() -> None:
    op.create_table(
        "report_summaries",
        sa.Column("report_id", sa.String(length=40), nullable=False),
        sa.Column("robot_id", sa.String(length=40), nullable=True),
        sa.Column("summary", sa.JSON(), nullable=True),
        sa.PrimaryKeyConstraint("report_id", name=op.f("pk_report_summaries")),
    )
    op.create_index("ix_report_summaries_robot_id_report_id", "report_summaries", ["robot_id", "report_id"])


def downgrade() -> None:
    op.drop_table("report_summaries")
