"""What people call the pose of an image, where that is no pose ID.

Revision: 0020, after 0019
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None
lost_on_the_way_down = "The names of poses that are no pose IDs."


def upgrade() -> None:
    op.add_column("measurements", sa.Column("pose_label", sa.String(200), nullable=True))


def downgrade() -> None:
    op.drop_column("measurements", "pose_label")
