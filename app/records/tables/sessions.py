"""Tables of targets, robots and their events, sessions and commanded poses."""

from __future__ import annotations

from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column, relationship

from app.records.tables.base import JsonList, JsonObject, Table, made_by_column


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
    print_kind: Mapped[str | None] = mapped_column(sa.String(32))
    shape_standard_uncertainty: Mapped[JsonObject | None]
    certificate: Mapped[JsonObject | None]
    created_at: Mapped[datetime]
    made_by: Mapped[str | None] = made_by_column()


def target_fields(target: Target) -> JsonObject:
    """Return what finding a target in an image takes of it: fields of `core.TargetSpec`."""
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


def measured_target_fields(target: Target, conditions: JsonObject | None) -> JsonObject:
    """Return what analyses take of a target (`core.targets.target_of`): what was measured of it as well, and with a
    certificate the temperature of the session.
    """
    fields = target_fields(target)
    fields["print_kind"] = target.print_kind
    fields["shape_standard_uncertainty"] = target.shape_standard_uncertainty
    fields["certificate"] = target.certificate
    if target.certificate is not None:
        fields["temperature_c"] = (conditions or {}).get("temperature_c")
    return fields


class Robot(Table):
    __tablename__ = "robots"

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(200))
    joints: Mapped[JsonList]
    joint_coupling: Mapped[JsonList | None]
    manufacturer: Mapped[str | None] = mapped_column(sa.String(200))
    model: Mapped[str | None] = mapped_column(sa.String(200))
    serial_number: Mapped[str | None] = mapped_column(sa.String(200))
    datasheet_repeatability_mm: Mapped[float | None] = mapped_column(sa.Double())
    datasheet_accuracy_mm: Mapped[float | None] = mapped_column(sa.Double())
    created_at: Mapped[datetime]
    made_by: Mapped[str | None] = made_by_column()


class RobotEvent(Table):
    """Something done to a robot, such as maintenance; `restarts_charts` where figures before and after it are not to be
    compared. It goes with its robot."""

    __tablename__ = "robot_events"
    __table_args__ = (sa.Index("ix_robot_events_robot_id_id", "robot_id", "id"),)

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    robot_id: Mapped[str] = mapped_column(sa.ForeignKey("robots.id", ondelete="CASCADE"))
    at: Mapped[datetime]
    note: Mapped[str] = mapped_column(sa.String(500))
    restarts_charts: Mapped[bool]
    created_at: Mapped[datetime]
    made_by: Mapped[str | None] = made_by_column()
    made_by_name: Mapped[str | None] = mapped_column(sa.String(200))


class Session(Table):
    __tablename__ = "sessions"

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(200))
    robot_id: Mapped[str | None] = mapped_column(sa.ForeignKey("robots.id"), index=True)
    lens: Mapped[JsonObject | None]
    intrinsics: Mapped[JsonObject | None]
    conditions: Mapped[JsonObject | None]
    camera_mount: Mapped[str] = mapped_column(sa.String(16), default="robot", server_default="robot")
    created_at: Mapped[datetime]
    made_by: Mapped[str | None] = made_by_column()

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
    """A commanded pose of the robot."""

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
