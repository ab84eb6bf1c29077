"""Poses measured by another instrument, as JSON."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.common import MAX_CYCLE, Coordinate, JointAngles, PoseTag, RequestModel, ResponseModel

MAX_MEASURED_POSES = 100_000

_Direction = Annotated[float, Field(ge=-2.0, le=2.0)]
_Covariance = Annotated[float, Field(ge=-1e18, le=1e18)]
Rotation = Annotated[
    list[Annotated[list[_Direction], Field(min_length=3, max_length=3)]],
    Field(
        min_length=3,
        max_length=3,
        description="3 x 3, right-handed and orthonormal to 1e-5: the probe's axes in the instrument's frame, by "
        "columns. Null where the instrument gives positions alone.",
    ),
]
Covariance = Annotated[
    list[Annotated[list[_Covariance], Field(min_length=6, max_length=6)]],
    Field(
        min_length=6,
        max_length=6,
        description="6 x 6: x, y, z (mm), then a small rotation (rad) w with R_true = exp(w) R_measured, all in the "
        "instrument's frame. Null where nothing is known; the last three rows and columns are not read "
        "where rotation is null.",
    ),
]
_CYCLE = "Which visit to the pose this is; null: another reading than all others of the pose."


class MeasuredPoseWrite(RequestModel):
    """One reading of an instrument at a pose of the robot."""

    pose_id: PoseTag
    cycle: Annotated[int, Field(ge=1, le=MAX_CYCLE, description=_CYCLE)] | None = None
    joint_angles_deg: JointAngles | None = None
    position_mm: Annotated[list[Coordinate], Field(min_length=3, max_length=3)]
    rotation: Rotation | None = None
    covariance: Covariance | None = None


MeasuredPoseList = Annotated[list[MeasuredPoseWrite], Field(max_length=MAX_MEASURED_POSES)]


class MeasuredPoseRead(ResponseModel):
    """One reading as stored; analyses name it by its id."""

    id: str
    pose_id: str
    cycle: int | None
    joint_angles_deg: list[float] | None
    position_mm: list[float]
    rotation: list[list[float]] | None
    covariance: list[list[float]] | None


class MeasuredPosePage(ResponseModel):
    items: list[MeasuredPoseRead]
    next_cursor: str | None
