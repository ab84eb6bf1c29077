"""The tables: one schema for SQLite and PostgreSQL.

Ids are time-ordered text (`ids.new_id`), so that "oldest first" is the order of the primary key. Documents that are
only ever read whole are JSON; arrays of a result are float64 bytes (`codec` knows the layout).
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column, relationship

STATUSES = ("queued", "running", "succeeded", "failed")
SCOPES = ("read", "upload", "admin")

JsonList = list[Any]
JsonObject = dict[str, Any]


class UtcDateTime(sa.types.TypeDecorator[datetime]):
    """An aware time in UTC; SQLite, which has no time zones, stores it naive."""

    impl = sa.DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        if value is None:
            return None
        value = value.astimezone(UTC)
        return value.replace(tzinfo=None) if dialect.name == "sqlite" else value

    def process_result_value(self, value: datetime | None, dialect: sa.Dialect) -> datetime | None:
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Table(DeclarativeBase):
    """Base of all tables; the naming convention lets batch migrations find every constraint."""

    metadata = sa.MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "ck": "ck_%(table_name)s_%(constraint_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map = {  # noqa: RUF012 - SQLAlchemy's own declaration
        datetime: UtcDateTime(),
        JsonList: sa.JSON(none_as_null=True),
        JsonObject: sa.JSON(none_as_null=True),
    }


class ApiKey(Table):
    """An API key: everything but the secret itself."""

    __tablename__ = "api_keys"
    __table_args__ = (sa.CheckConstraint("scope IN ('read', 'upload', 'admin')", name="scope"),)

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(200))
    scope: Mapped[str] = mapped_column(sa.String(16))
    secret_hmac: Mapped[str] = mapped_column(sa.String(64))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]


class Target(Table):
    __tablename__ = "targets"

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(200))
    kind: Mapped[str] = mapped_column(sa.String(32))
    columns: Mapped[int]
    rows: Mapped[int]
    pitch_mm: Mapped[float] = mapped_column(sa.Double())
    marker_mm: Mapped[float | None] = mapped_column(sa.Double())
    dictionary: Mapped[str | None] = mapped_column(sa.String(64))
    legacy_layout: Mapped[bool]
    pitch_standard_uncertainty_mm: Mapped[float | None] = mapped_column(sa.Double())
    created_at: Mapped[datetime]


def target_fields(target: Target) -> JsonObject:
    """Return what the numerics take of a target: the fields of `core.TargetSpec`."""
    return {
        name: getattr(target, name)
        for name in (
            "kind",
            "columns",
            "rows",
            "pitch_mm",
            "marker_mm",
            "dictionary",
            "legacy_layout",
            "pitch_standard_uncertainty_mm",
        )
    }


class Robot(Table):
    __tablename__ = "robots"

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(200))
    joints: Mapped[JsonList]
    repeatability_mm: Mapped[float | None] = mapped_column(sa.Double())
    created_at: Mapped[datetime]


class Session(Table):
    __tablename__ = "sessions"

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(200))
    robot_id: Mapped[str | None] = mapped_column(sa.ForeignKey("robots.id"), index=True)
    lens: Mapped[JsonObject | None]
    intrinsics: Mapped[JsonObject | None]
    created_at: Mapped[datetime]

    targets: Mapped[list[SessionTarget]] = relationship(
        order_by="SessionTarget.position", cascade="all, delete-orphan", passive_deletes=True, lazy="selectin"
    )


class SessionTarget(Table):
    """Which targets a session looks at, in the order given."""

    __tablename__ = "session_targets"

    session_id: Mapped[str] = mapped_column(
        sa.ForeignKey("sessions.id", ondelete="CASCADE"), primary_key=True
    )
    position: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    target_id: Mapped[str] = mapped_column(sa.ForeignKey("targets.id"), index=True)


class Pose(Table):
    """What the robot was told."""

    __tablename__ = "poses"
    __table_args__ = (
        sa.UniqueConstraint("session_id", "pose_id"),
        sa.Index("ix_poses_session_id_id", "session_id", "id"),
    )

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    session_id: Mapped[str] = mapped_column(sa.ForeignKey("sessions.id", ondelete="CASCADE"))
    pose_id: Mapped[str] = mapped_column(sa.String(128))
    position_mm: Mapped[JsonList | None]
    roll_deg: Mapped[float | None] = mapped_column(sa.Double())
    pitch_deg: Mapped[float | None] = mapped_column(sa.Double())
    yaw_deg: Mapped[float | None] = mapped_column(sa.Double())
    joint_angles_deg: Mapped[JsonList | None]
    approach: Mapped[str | None] = mapped_column(sa.String(200))


class Measurement(Table):
    """One image and what came of it of one target. The row is the queue: `status` says whose turn it is.

    `seeks_target`: the upload named no target, so that detection finds which of the session's are shown; `target_id`
    is null until it has, and where it finds none. What else the image shows has rows of its own, which do not seek.
    """

    __tablename__ = "measurements"
    __table_args__ = (
        sa.UniqueConstraint("session_id", "pose_id", "sha256", "target_id"),
        sa.ForeignKeyConstraint(
            ["session_id", "pose_id"], ["poses.session_id", "poses.pose_id"], ondelete="CASCADE"
        ),
        sa.CheckConstraint("status IN ('queued', 'running', 'succeeded', 'failed')", name="status"),
        sa.Index("ix_measurements_session_id_id", "session_id", "id"),
        sa.Index("ix_measurements_session_id_status", "session_id", "status"),
        sa.Index("ix_measurements_status_id", "status", "id"),
        sa.Index("ix_measurements_sha256", "sha256"),
        sa.Index("ix_measurements_target_id", "target_id"),
        # Unique although target_id may be null, which the constraint above lets pass any number of times.
        sa.Index(
            "uq_measurements_seeking",
            "session_id",
            "pose_id",
            "sha256",
            unique=True,
            sqlite_where=sa.text("seeks_target"),
            postgresql_where=sa.text("seeks_target"),
        ),
    )

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    session_id: Mapped[str] = mapped_column(sa.ForeignKey("sessions.id", ondelete="CASCADE"))
    pose_id: Mapped[str] = mapped_column(sa.String(128))
    target_id: Mapped[str | None] = mapped_column(sa.ForeignKey("targets.id"))
    seeks_target: Mapped[bool] = mapped_column(default=False, server_default=sa.false())
    cycle: Mapped[int | None]
    focus_group: Mapped[str] = mapped_column(sa.String(200))
    joint_angles_deg: Mapped[JsonList | None]
    captured_at: Mapped[datetime | None]
    received_at: Mapped[datetime]
    finished_at: Mapped[datetime | None]
    sha256: Mapped[str] = mapped_column(sa.String(64))
    filename: Mapped[str | None] = mapped_column(sa.String(255))
    bytes: Mapped[int] = mapped_column(sa.BigInteger())
    image_format: Mapped[str] = mapped_column(sa.String(16))
    image_width_px: Mapped[int]
    image_height_px: Mapped[int]
    status: Mapped[str] = mapped_column(sa.String(16))
    attempts: Mapped[int]
    claim: Mapped[str | None] = mapped_column(sa.String(40))
    duration_ms: Mapped[float | None] = mapped_column(sa.Double())
    failure_code: Mapped[str | None] = mapped_column(sa.String(64))
    failure_detail: Mapped[str | None] = mapped_column(sa.Text())
    failure_advice: Mapped[str | None] = mapped_column(sa.Text())

    result: Mapped[Result | None] = relationship(
        cascade="all, delete-orphan", passive_deletes=True, lazy="raise", uselist=False
    )


class MeasuredPose(Table):
    """One reading of another instrument: a laser tracker, a measuring machine.

    `content_sha256` is over all that the client sent of it, so that sending it again stores nothing.
    """

    __tablename__ = "measured_poses"
    __table_args__ = (
        sa.UniqueConstraint("session_id", "pose_id", "cycle"),
        sa.UniqueConstraint("session_id", "pose_id", "content_sha256"),
        sa.ForeignKeyConstraint(
            ["session_id", "pose_id"], ["poses.session_id", "poses.pose_id"], ondelete="CASCADE"
        ),
        sa.Index("ix_measured_poses_session_id_id", "session_id", "id"),
    )

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    session_id: Mapped[str] = mapped_column(sa.ForeignKey("sessions.id", ondelete="CASCADE"))
    pose_id: Mapped[str] = mapped_column(sa.String(128))
    cycle: Mapped[int | None]
    joint_angles_deg: Mapped[JsonList | None]
    position_mm: Mapped[JsonList]
    rotation: Mapped[JsonList | None]
    covariance: Mapped[JsonList | None]
    content_sha256: Mapped[str] = mapped_column(sa.String(64))


class Result(Table):
    """What one computation gave, with enough beside it to compute it again.

    `calibration` is the document the API shows; `state` and `points` are its arrays without loss (`codec`). A
    refused view has points and no calibration. `markers` are the corners of the markers seen, null for targets without
    any and for what was measured before they were kept. `origin` and `capture_quality` are those of the grid points,
    null where there are none and for what was measured before they were kept.
    """

    __tablename__ = "results"

    measurement_id: Mapped[str] = mapped_column(
        sa.ForeignKey("measurements.id", ondelete="CASCADE"), primary_key=True
    )
    estimator: Mapped[str | None] = mapped_column(sa.String(32))
    calibration: Mapped[JsonObject | None] = mapped_column(sa.JSON(none_as_null=True))
    state: Mapped[bytes | None] = mapped_column(sa.LargeBinary(), deferred=True)
    points: Mapped[bytes | None] = mapped_column(sa.LargeBinary(), deferred=True)
    markers: Mapped[bytes | None] = mapped_column(sa.LargeBinary(), deferred=True)
    points_warnings: Mapped[JsonList | None] = mapped_column(sa.JSON(none_as_null=True), deferred=True)
    origin: Mapped[str | None] = mapped_column(sa.String(16))
    capture_quality: Mapped[JsonObject | None] = mapped_column(sa.JSON(none_as_null=True))
    core_version: Mapped[str] = mapped_column(sa.String(32))
    settings: Mapped[JsonObject] = mapped_column(sa.JSON(), deferred=True)
    input_sha256: Mapped[str] = mapped_column(sa.String(64))
