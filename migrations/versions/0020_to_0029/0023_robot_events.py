"""What was done to robots.

Revision: 0023, after 0022
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None
lost_on_the_way_down = "The events of robots. Save them first (`gridpose robots events list`)."


def upgrade() -> None:
    op.create_table(
        "robot_events",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("robot_id", sa.String(length=40), nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("note", sa.String(length=500), nullable=False),
        sa.Column("restarts_charts", sa.Boolean(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("made_by", sa.String(length=40), nullable=True),
        sa.Column("made_by_name", sa.String(length=200), nullable=True),
        sa.ForeignKeyConstraint(
            ["robot_id"], ["robots.id"], name=op.f("fk_robot_events_robot_id_robots"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_robot_events")),
    )
    op.create_index("ix_robot_events_robot_id_id", "robot_events", ["robot_id", "id"])


def downgrade() -> None:
    op.drop_table("robot_events")
