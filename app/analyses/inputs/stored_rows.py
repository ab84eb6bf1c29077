"""Rows as analyses read them, column by column, and the substitute for an unreadable row."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import sqlalchemy as sa

from app.errors import RowUnreadable
from app.records.codec import POINT_BYTES
from app.records.readable import CODE, check_of, is_readable
from app.records.tables import Measurement, Pose, Result, Table

_LENGTH_ALONE = ("points",)
"""Of these columns the length is read."""
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
        for name in ("excluded", "filename", "burst", "captured_at", "received_at", "stated_target_id")
    ),
)
IMAGE_ROWS = sa.select(*(sa.func.length(c) if c.name in _LENGTH_ALONE else c for c in _COLUMNS))
"""Selects the fields of `snapshot.StoredImage`, the exclusion, the file's name, the burst index, its times and
the target stated; the caller joins the results and selects the rows.
"""

_CHECK_BY_NAME: dict[str, Callable[[Any], bool]] = {
    "points": lambda length: bool(length % POINT_BYTES == 0),
    "labelling": lambda value: value in ("absolute", "up_to_symmetry", "partial"),
}
_CHECKS = [  # looked up once: there may be 100,000 rows; and there may be no result
    (c.name, bool(c.nullable or c.table is Result.__table__), _CHECK_BY_NAME.get(c.name, check_of(c)))
    for c in _COLUMNS
]

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
    damaged = [
        name
        for (name, may_be_null, check), value in zip(_CHECKS, row, strict=True)
        if not (may_be_null if value is None else check(value))
    ]
    if not damaged:
        return tuple(row)
    detail = f"What is stored of this measurement cannot be read: {', '.join(damaged)}."
    return (*row[:2], None, *row[3:5], "default", None, 0, 0, CODE, detail, *[None] * 10)


def require_values(noun: str, name: str, table: type[Table], values: Any) -> None:
    """Raise RowUnreadable if a field of `values`, a dataclass with slots, holds what the table does not allow."""
    columns = table.__table__.c
    damaged = [f for f in values.__slots__ if not is_readable(columns[f], getattr(values, f))]
    if damaged:
        raise RowUnreadable(f"{noun} ({name})", damaged)
