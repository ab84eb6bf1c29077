"""The target that an upload named, kept when the session looks at others and the image is searched for them.

Revision: 0028, after 0027

Until now, rows that do not search were those that named their target, and those that a search of the same image added.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0028"
down_revision = "0027"
branch_labels = None
depends_on = None
lost_on_the_way_down = (
    "Which targets were stated of images whose target was taken out of their session: putting it back searches them "
    "for all of the session's targets."
)

_STATED = """
UPDATE measurements SET stated_target_id = target_id
WHERE NOT seeks_target AND target_id IS NOT NULL AND NOT EXISTS (
    SELECT 1 FROM measurements AS other
    WHERE other.session_id = measurements.session_id AND other.pose_id = measurements.pose_id
        AND other.sha256 = measurements.sha256 AND other.seeks_target
)
"""


def upgrade() -> None:
    # No foreign key: a target that nothing is a measurement of may be deleted, whatever was stated.
    op.add_column("measurements", sa.Column("stated_target_id", sa.String(length=40), nullable=True))
    op.execute(sa.text(_STATED))


def downgrade() -> None:
    op.drop_column("measurements", "stated_target_id")
