"""Place of an image within its stop: images of one burst are one visit.

Revision: 0021, after 0020
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = "0020"
branch_labels = None
depends_on = None
lost_on_the_way_down = "Which images are of one stop: analyses count each of them as a cycle again."


def upgrade() -> None:
    op.add_column("measurements", sa.Column("burst", sa.Integer(), nullable=True))


def downgrade() -> None:
    op.drop_column("measurements", "burst")
