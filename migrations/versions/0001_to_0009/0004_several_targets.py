"""Several targets in one image; what is known of the origin of grid points, and the quality of the image.

Revision: 0004, after 0003
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None
lost_on_the_way_down = (
    "The rows of images that show none of their session's targets; "
    "the origin of stored grid points and their capture quality. A retry of the images determines both again."
)


def _checks() -> tuple[sa.CheckConstraint, ...]:
    """Return the checks that SQLite loses when it makes a table anew, unless they are given."""
    return (
        sa.CheckConstraint(
            "status IN ('queued', 'running', 'succeeded', 'failed')", name=op.f("ck_measurements_status")
        ),
    )


def upgrade() -> None:
    with op.batch_alter_table("measurements", schema=None, table_args=_checks()) as batch_op:
        batch_op.add_column(
            sa.Column("seeks_target", sa.Boolean(), nullable=False, server_default=sa.false())
        )
        batch_op.alter_column("target_id", existing_type=sa.String(length=40), nullable=True)
    # In sessions with one target, sending an image with or without its name was the same thing.
    op.execute(
        "UPDATE measurements SET seeks_target = (SELECT count(*) FROM session_targets "
        "WHERE session_targets.session_id = measurements.session_id) = 1"
    )
    op.create_index(
        "uq_measurements_seeking",
        "measurements",
        ["session_id", "pose_id", "sha256"],
        unique=True,
        sqlite_where=sa.text("seeks_target"),
        postgresql_where=sa.text("seeks_target"),
    )
    with op.batch_alter_table("results", schema=None) as batch_op:
        batch_op.add_column(sa.Column("origin", sa.String(length=16), nullable=True))
        batch_op.add_column(sa.Column("capture_quality", sa.JSON(none_as_null=True), nullable=True))


def downgrade() -> None:
    with op.batch_alter_table("results", schema=None) as batch_op:
        batch_op.drop_column("capture_quality")
        batch_op.drop_column("origin")
    op.drop_index("uq_measurements_seeking", table_name="measurements")
    # What shows none of a session's targets has no place in the older schema; its original stays.
    op.execute(
        "DELETE FROM results WHERE measurement_id IN (SELECT id FROM measurements WHERE target_id IS NULL)"
    )
    op.execute("DELETE FROM measurements WHERE target_id IS NULL")
    with op.batch_alter_table("measurements", schema=None, table_args=_checks()) as batch_op:
        batch_op.alter_column("target_id", existing_type=sa.String(length=40), nullable=False)
        batch_op.drop_column("seeks_target")
