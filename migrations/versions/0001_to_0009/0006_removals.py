"""Originals that are to be removed; why a retry left the earlier result in place.

Revision: 0006, after 0005
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None
lost_on_the_way_down = (
    "Which originals are still to be removed, and why a retry kept the earlier result. "
    "A later version's sweep finds the files."
)


def upgrade() -> None:
    op.create_table(
        "removals",
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("recorded_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("sha256", name=op.f("pk_removals")),
    )
    op.add_column("measurements", sa.Column("retry_failure", sa.JSON(none_as_null=True), nullable=True))


def downgrade() -> None:
    # SQLite can do this since 3.35, which RETURNING needs as well; the table need not be made anew.
    op.drop_column("measurements", "retry_failure")
    # The older version does not look for what is still to be removed; a later one finds it by its sweep.
    op.drop_table("removals")
