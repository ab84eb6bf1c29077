"""Conditions under which a session's robot was measured.

Revision: 0013, after 0012
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None
lost_on_the_way_down = (
    "The conditions that sessions state: temperature, load, speed, warm-up, operator and notes."
)


def upgrade() -> None:
    op.add_column("sessions", sa.Column("conditions", sa.JSON(none_as_null=True), nullable=True))


def downgrade() -> None:
    op.drop_column("sessions", "conditions")
