"""Whether a session's camera is on the robot or fixed; that of earlier sessions is on the robot.

Revision: 0026, after 0025
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0026"
down_revision = "0025"
branch_labels = None
depends_on = None
lost_on_the_way_down = (
    "Which sessions have a fixed camera: analyses take each camera as one on the robot again."
)


def upgrade() -> None:
    op.add_column(
        "sessions", sa.Column("camera_mount", sa.String(length=16), server_default="robot", nullable=False)
    )


def downgrade() -> None:
    op.drop_column("sessions", "camera_mount")
