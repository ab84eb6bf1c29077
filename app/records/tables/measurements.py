"""Tables of measurements, their results and originals, and of poses measured by other instruments."""

from __future__ import annotations

from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column, relationship

from app.records.tables.base import Bytes, JsonList, JsonObject, Table, made_by_column


class Measurement(Table):
    """One image and what came of it of one target. The row is the queue: `status` says whose turn it is.

    `seeks_target`: the upload named no target, so that detection finds which of the session's are shown; `target_id`
    is null until it has, and where it finds none. What else the image shows has rows of its own, which do not seek.
    `stated_target_id` is the target that the upload named. The row seeks only while the session does not look at it.

    Where the row has a result, `failure_...`, `finished_at` and `duration_ms` are those of that result, also while the
    row is `queued` or `running` again. `retry_failure` (code, detail, advice) says why the last retry computed nothing,
    so that the earlier result stands. `excluded` (reason, by, at) says that a user keeps the row out of analyses.
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
        # The queue: which sessions wait, and each one's oldest image, at one step of the index each.
        sa.Index("ix_measurements_status_session_id_id", "status", "session_id", "id"),
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
    stated_target_id: Mapped[str | None] = mapped_column(sa.String(40))
    cycle: Mapped[int | None]
    burst: Mapped[int | None]
    focus_group: Mapped[str] = mapped_column(sa.String(200))
    joint_angles_deg: Mapped[JsonList | None]
    captured_at: Mapped[datetime | None]
    received_at: Mapped[datetime]
    finished_at: Mapped[datetime | None]
    sha256: Mapped[str] = mapped_column(sa.String(64))
    filename: Mapped[str | None] = mapped_column(sa.String(255))
    pose_label: Mapped[str | None] = mapped_column(sa.String(200))
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
    retry_failure: Mapped[JsonObject | None]
    excluded: Mapped[JsonObject | None]
    made_by: Mapped[str | None] = made_by_column()

    result: Mapped[Result | None] = relationship(
        cascade="all, delete-orphan", passive_deletes=True, lazy="raise", uselist=False
    )


class MeasurementChange(Table):
    """The latest change of a measurement's status, as a place in the order of its session's changes.

    Triggers of the database write it in the transaction of the change, whoever makes it (migration 0027). A measurement
    has none whose last change is older than the triggers. `number` grows within the session: microseconds since 1970,
    more where the clock was set back.
    """

    __tablename__ = "measurement_changes"
    __table_args__ = (
        sa.Index(
            "ix_measurement_changes_session_id_number_measurement_id",
            *("session_id", "number", "measurement_id"),
        ),
        {"sqlite_with_rowid": False},
    )

    measurement_id: Mapped[str] = mapped_column(
        sa.ForeignKey("measurements.id", ondelete="CASCADE"), primary_key=True
    )
    session_id: Mapped[str] = mapped_column(sa.String(40))
    number: Mapped[int] = mapped_column(sa.BigInteger())


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
    made_by: Mapped[str | None] = made_by_column()


class Result(Table):
    """The result of one computation, with what is needed to compute it again.

    `calibration` is the document the API shows; `points` are the grid points without loss (`codec`). A refused view has
    points and no calibration. `markers` are the corners of the markers seen, null for targets without markers and for
    results older than the column. `content_sha256` covers both (`codec.content_hash`): whoever replaces one replaces
    it. `labelling` and `capture_quality` describe the grid points; they are null without grid points and for results
    older than the columns.
    """

    __tablename__ = "results"
    __table_args__ = (
        # The hashes of a session's results without reading the arrays between them.
        sa.Index("ix_results_content", "measurement_id", "content_sha256"),
    )

    measurement_id: Mapped[str] = mapped_column(
        sa.ForeignKey("measurements.id", ondelete="CASCADE"), primary_key=True
    )
    estimator: Mapped[str | None] = mapped_column(sa.String(32))
    calibration: Mapped[JsonObject | None] = mapped_column(sa.JSON(none_as_null=True))
    points: Mapped[bytes | None] = mapped_column(Bytes(), deferred=True)
    markers: Mapped[bytes | None] = mapped_column(Bytes(), deferred=True)
    points_warnings: Mapped[JsonList | None] = mapped_column(sa.JSON(none_as_null=True), deferred=True)
    labelling: Mapped[str | None] = mapped_column(sa.String(16))
    capture_quality: Mapped[JsonObject | None] = mapped_column(sa.JSON(none_as_null=True))
    content_sha256: Mapped[str] = mapped_column(sa.String(64))
    core_version: Mapped[str] = mapped_column(sa.String(32))
    settings: Mapped[JsonObject] = mapped_column(sa.JSON(), deferred=True)
    input_sha256: Mapped[str] = mapped_column(sa.String(64))


class Removal(Table):
    """An original whose last row may be gone: its file is to be removed unless a measurement names it.

    Written in the transaction that deletes the rows, so that neither a crash nor a failed unlink forgets the file.
    """

    __tablename__ = "removals"

    sha256: Mapped[str] = mapped_column(sa.String(64), primary_key=True)
    recorded_at: Mapped[datetime]
