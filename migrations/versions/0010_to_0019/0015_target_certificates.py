"""What is known of a print: its kind, the uncertainty of its shape, its certificate.

Revision: 0015, after 0014
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None
lost_on_the_way_down = "The kinds of prints, the uncertainties of their shapes, and their certificates."


def upgrade() -> None:
    op.add_column("targets", sa.Column("print_kind", sa.String(32), nullable=True))
    op.add_column("targets", sa.Column("shape_standard_uncertainty", sa.JSON(), nullable=True))
    op.add_column("targets", sa.Column("certificate", sa.JSON(), nullable=True))


def downgrade() -> None:
    for name in ("certificate", "shape_standard_uncertainty", "print_kind"):
        op.drop_column("targets", name)
