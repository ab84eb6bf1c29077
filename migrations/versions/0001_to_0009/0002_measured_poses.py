"""Poses that other instruments measured.

Revision: 0002, after 0001
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None
lost_on_the_way_down = "All measured poses of other instruments."


def upgrade() -> None:
    op.create_table(
        "measured_poses",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("pose_id", sa.String(length=128), nullable=False),
        sa.Column("cycle", sa.Integer(), nullable=True),
        sa.Column("joint_angles_deg", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("position_mm", sa.JSON(none_as_null=True), nullable=False),
        sa.Column("rotation", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("covariance", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("content_sha256", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(
            ["session_id", "pose_id"],
            ["poses.session_id", "poses.pose_id"],
            name=op.f("fk_measured_poses_session_id_pose_id_poses"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["session_id"],
            ["sessions.id"],
            name=op.f("fk_measured_poses_session_id_sessions"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_measured_poses")),
        sa.UniqueConstraint(
            "session_id",
            "pose_id",
            "content_sha256",
            name=op.f("uq_measured_poses_session_id_pose_id_content_sha256"),
        ),
        sa.UniqueConstraint(
            "session_id", "pose_id", "cycle", name=op.f("uq_measured_poses_session_id_pose_id_cycle")
        ),
    )
    with op.batch_alter_table("measured_poses", schema=None) as batch_op:
        batch_op.create_index("ix_measured_poses_session_id_id", ["session_id", "id"], unique=False)


def downgrade() -> None:
    with op.batch_alter_table("measured_poses", schema=None) as batch_op:
        batch_op.drop_index("ix_measured_poses_session_id_id")

    op.drop_table("measured_poses")
