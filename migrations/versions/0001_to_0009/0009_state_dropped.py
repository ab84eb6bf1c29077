"""Results without `state`: a copy, as bytes, of what `calibration` holds; nothing reads it.

Revision: 0009, after 0008
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None
lost_on_the_way_down = "Nothing: `results.state` stays empty until a retry, and no version reads it."


def upgrade() -> None:
    # SQLite can do this since 3.35, which RETURNING needs as well; the table need not be made anew.
    op.drop_column("results", "state")


def downgrade() -> None:
    op.add_column("results", sa.Column("state", sa.LargeBinary(), nullable=True))
