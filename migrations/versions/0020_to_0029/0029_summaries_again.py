"""What is compared of reports is taken from them again: images without a time of capture are of the time they came.

Revision: 0029, after 0028
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0029"
down_revision = "0028"
branch_labels = None
depends_on = None
lost_on_the_way_down = "Nothing: what is compared of reports is taken from them again."


def upgrade() -> None:
    op.execute(sa.text("DELETE FROM report_summaries"))


def downgrade() -> None:
    op.execute(sa.text("DELETE FROM report_summaries"))
