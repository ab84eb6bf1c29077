"""The first tables: keys, targets, robots, sessions, poses, measurements and their results.

Revision: 0001, the first
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None
lost_on_the_way_down = "Everything."


def upgrade() -> None:
    op.create_table(
        "api_keys",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("scope", sa.String(length=16), nullable=False),
        sa.Column("secret_hmac", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("scope IN ('read', 'upload', 'admin')", name=op.f("ck_api_keys_scope")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_api_keys")),
    )
    op.create_table(
        "robots",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("joints", sa.JSON(none_as_null=True), nullable=False),
        sa.Column("repeatability_mm", sa.Double(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_robots")),
    )
    op.create_table(
        "targets",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("columns", sa.Integer(), nullable=False),
        sa.Column("rows", sa.Integer(), nullable=False),
        sa.Column("pitch_mm", sa.Double(), nullable=False),
        sa.Column("marker_mm", sa.Double(), nullable=True),
        sa.Column("dictionary", sa.String(length=64), nullable=True),
        sa.Column("legacy_layout", sa.Boolean(), nullable=False),
        sa.Column("pitch_standard_uncertainty_mm", sa.Double(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_targets")),
    )
    op.create_table(
        "sessions",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("robot_id", sa.String(length=40), nullable=True),
        sa.Column("lens", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("intrinsics", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["robot_id"], ["robots.id"], name=op.f("fk_sessions_robot_id_robots")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_sessions")),
    )
    with op.batch_alter_table("sessions", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_sessions_robot_id"), ["robot_id"], unique=False)

    op.create_table(
        "poses",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("pose_id", sa.String(length=128), nullable=False),
        sa.Column("position_mm", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("roll_deg", sa.Double(), nullable=True),
        sa.Column("pitch_deg", sa.Double(), nullable=True),
        sa.Column("yaw_deg", sa.Double(), nullable=True),
        sa.Column("joint_angles_deg", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("approach", sa.String(length=200), nullable=True),
        sa.ForeignKeyConstraint(
            ["session_id"], ["sessions.id"], name=op.f("fk_poses_session_id_sessions"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_poses")),
        sa.UniqueConstraint("session_id", "pose_id", name=op.f("uq_poses_session_id_pose_id")),
    )
    with op.batch_alter_table("poses", schema=None) as batch_op:
        batch_op.create_index("ix_poses_session_id_id", ["session_id", "id"], unique=False)

    op.create_table(
        "session_targets",
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("position", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("target_id", sa.String(length=40), nullable=False),
        sa.ForeignKeyConstraint(
            ["session_id"],
            ["sessions.id"],
            name=op.f("fk_session_targets_session_id_sessions"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["target_id"], ["targets.id"], name=op.f("fk_session_targets_target_id_targets")
        ),
        sa.PrimaryKeyConstraint("session_id", "position", name=op.f("pk_session_targets")),
    )
    with op.batch_alter_table("session_targets", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_session_targets_target_id"), ["target_id"], unique=False)

    op.create_table(
        "measurements",
        sa.Column("id", sa.String(length=40), nullable=False),
        sa.Column("session_id", sa.String(length=40), nullable=False),
        sa.Column("pose_id", sa.String(length=128), nullable=False),
        sa.Column("target_id", sa.String(length=40), nullable=False),
        sa.Column("cycle", sa.Integer(), nullable=True),
        sa.Column("focus_group", sa.String(length=200), nullable=False),
        sa.Column("joint_angles_deg", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("captured_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("received_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("filename", sa.String(length=255), nullable=True),
        sa.Column("bytes", sa.BigInteger(), nullable=False),
        sa.Column("image_format", sa.String(length=16), nullable=False),
        sa.Column("image_width_px", sa.Integer(), nullable=False),
        sa.Column("image_height_px", sa.Integer(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("claim", sa.String(length=40), nullable=True),
        sa.Column("duration_ms", sa.Double(), nullable=True),
        sa.Column("failure_code", sa.String(length=64), nullable=True),
        sa.Column("failure_detail", sa.Text(), nullable=True),
        sa.Column("failure_advice", sa.Text(), nullable=True),
        sa.CheckConstraint(
            "status IN ('queued', 'running', 'succeeded', 'failed')", name=op.f("ck_measurements_status")
        ),
        sa.ForeignKeyConstraint(
            ["session_id", "pose_id"],
            ["poses.session_id", "poses.pose_id"],
            name=op.f("fk_measurements_session_id_pose_id_poses"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["session_id"],
            ["sessions.id"],
            name=op.f("fk_measurements_session_id_sessions"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["target_id"], ["targets.id"], name=op.f("fk_measurements_target_id_targets")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_measurements")),
        sa.UniqueConstraint(
            "session_id",
            "pose_id",
            "sha256",
            "target_id",
            name=op.f("uq_measurements_session_id_pose_id_sha256_target_id"),
        ),
    )
    with op.batch_alter_table("measurements", schema=None) as batch_op:
        batch_op.create_index("ix_measurements_session_id_id", ["session_id", "id"], unique=False)
        batch_op.create_index("ix_measurements_session_id_status", ["session_id", "status"], unique=False)
        batch_op.create_index("ix_measurements_sha256", ["sha256"], unique=False)
        batch_op.create_index("ix_measurements_status_id", ["status", "id"], unique=False)
        batch_op.create_index("ix_measurements_target_id", ["target_id"], unique=False)

    op.create_table(
        "results",
        sa.Column("measurement_id", sa.String(length=40), nullable=False),
        sa.Column("estimator", sa.String(length=32), nullable=True),
        sa.Column("calibration", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("state", sa.LargeBinary(), nullable=True),
        sa.Column("points", sa.LargeBinary(), nullable=True),
        sa.Column("points_warnings", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("core_version", sa.String(length=32), nullable=False),
        sa.Column("settings", sa.JSON(), nullable=False),
        sa.Column("input_sha256", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(
            ["measurement_id"],
            ["measurements.id"],
            name=op.f("fk_results_measurement_id_measurements"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("measurement_id", name=op.f("pk_results")),
    )


def downgrade() -> None:
    op.drop_table("results")
    with op.batch_alter_table("measurements", schema=None) as batch_op:
        batch_op.drop_index("ix_measurements_target_id")
        batch_op.drop_index("ix_measurements_status_id")
        batch_op.drop_index("ix_measurements_sha256")
        batch_op.drop_index("ix_measurements_session_id_status")
        batch_op.drop_index("ix_measurements_session_id_id")

    op.drop_table("measurements")
    with op.batch_alter_table("session_targets", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_session_targets_target_id"))

    op.drop_table("session_targets")
    with op.batch_alter_table("poses", schema=None) as batch_op:
        batch_op.drop_index("ix_poses_session_id_id")

    op.drop_table("poses")
    with op.batch_alter_table("sessions", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_sessions_robot_id"))

    op.drop_table("sessions")
    op.drop_table("targets")
    op.drop_table("robots")
    op.drop_table("api_keys")
