"""How a robot's joints are coupled: the angles of its model from those that its controller states.

Revision: 0016, after 0015
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None
lost_on_the_way_down = "The coupling of robots' joints."


def upgrade() -> None:
    op.add_column("robots", sa.Column("joint_coupling", sa.JSON(none_as_null=True), nullable=True))


def downgrade() -> None:
    op.drop_column("robots", "joint_coupling")
