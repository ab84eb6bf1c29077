"""Who made a robot, and the accuracy that its data sheet states.

Revision: 0014, after 0013
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None
lost_on_the_way_down = (
    "The maker, model and serial number of robots, and the accuracy that data sheets state."
)

_TEXTS = ("manufacturer", "model", "serial_number")


def upgrade() -> None:
    for name in _TEXTS:
        op.add_column("robots", sa.Column(name, sa.String(200), nullable=True))
    op.add_column("robots", sa.Column("datasheet_accuracy_mm", sa.Double(), nullable=True))


def downgrade() -> None:
    op.drop_column("robots", "datasheet_accuracy_mm")
    for name in reversed(_TEXTS):
        op.drop_column("robots", name)
