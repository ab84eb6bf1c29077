"""Measurements that a user excludes from analyses, with the reason.

Revision: 0011, after 0010
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None
lost_on_the_way_down = "Which measurements were excluded from analyses, and why: analyses use them again."


def upgrade() -> None:
    op.add_column("measurements", sa.Column("excluded", sa.JSON(none_as_null=True), nullable=True))


def downgrade() -> None:
    # SQLite can do this since 3.35, which RETURNING needs as well; the table need not be made anew.
    op.drop_column("measurements", "excluded")
