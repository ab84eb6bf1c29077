"""The queue by session: the next image of every session is one step of an index away.

Revision: 0005, after 0004
"""

from __future__ import annotations

from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None
lost_on_the_way_down = "Nothing."


def upgrade() -> None:
    op.create_index("ix_measurements_status_session_id_id", "measurements", ["status", "session_id", "id"])
    op.drop_index("ix_measurements_status_id", table_name="measurements")


def downgrade() -> None:
    op.create_index("ix_measurements_status_id", "measurements", ["status", "id"])
    op.drop_index("ix_measurements_status_session_id_id", table_name="measurements")
