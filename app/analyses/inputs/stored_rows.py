"""Rows as analyses read them, column by column, and the substitute for an unreadable row."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa

from app.errors import RowUnreadable
from app.records.codec import POINT_BYTES
from app.records.readable import CODE, is_readable
from app.records.tables import Measurement, Pose, Result, Table

_SIZES = {"points": POINT_BYTES}
"""Of these columns the length alone is read."""
_COLUMNS = (  # in the order of the fields of `ImageObservation` and `snapshot.StoredImage`, then what is only shown
    *(
        Measurement.__table__.c[name]
        for name in (
            "id",
            "pose_id",
            "cycle",
            "sha256",
            "target_id",
            "focus_group",
            "joint_angles_deg",
            "image_width_px",
            "image_height_px",
            "failure_code",
            "failure_detail",
        )
    ),
    *(Result.__table__.c[name] for name in ("points", "core_version", "content_sha256", "labelling")),
    *(
        Measurement.__table__.c[name]
        for name in ("excluded", "filename", "burst", "captured_at", "received_at")
    ),
)
IMAGE_ROWS = sa.select(*(sa.func.length(c) if c.name in _SIZES else c for c in _COLUMNS))
"""Selects the fields of `snapshot.StoredImage`, the exclusion, the file's name, the burst index and its times; the
caller joins the results and selects the rows.
"""

POSE_COLUMNS = (  # of `CommandedPose`, after the pose's name
    Pose.pose_id,
    Pose.position_mm,
    Pose.roll_deg,
    Pose.pitch_deg,
    Pose.yaw_deg,
    Pose.joint_angles_deg,
    Pose.approach,
)


def readable_image(row: sa.Row[Any]) -> tuple[Any, ...]:
    """Return the columns of an `IMAGE_ROWS` row; those of a failed image without points where some cannot be read."""
    damaged = [c.name for c, value in zip(_COLUMNS, row, strict=True) if not _is_sound(c, value)]
    if not damaged:
        return tuple(row)
    detail = f"What is stored of this measurement cannot be read: {', '.join(damaged)}."
    return (*row[:2], None, *row[3:5], "default", None, 0, 0, CODE, detail, *[None] * 9)


def require_values(noun: str, name: str, table: type[Table], values: Any) -> None:
    """Raise RowUnreadable if a field of `values`, a dataclass with slots, holds what the table does not allow."""
    columns = table.__table__.c
    damaged = [f for f in values.__slots__ if not is_readable(columns[f], getattr(values, f))]
    if damaged:
        raise RowUnreadable(f"{noun} ({name})", damaged)


def _is_sound(column: Any, value: Any) -> bool:
    if value is None:
        return bool(column.nullable or column.table is Result.__table__)  # there may be no result
    if column.name in _SIZES:
        return bool(value % _SIZES[column.name] == 0)
    if column.name == "labelling":
        return value in ("absolute", "up_to_symmetry", "partial")
    return is_readable(column, value)
