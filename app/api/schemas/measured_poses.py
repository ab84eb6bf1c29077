"""Poses measured by another instrument, as JSON."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.common import (
    MAX_CYCLE,
    Coordinate,
    RequestModel,
    ResponseModel,
    StoredPage,
)
from app.api.schemas.fields import PoseId, PoseIdField, StatedAngles, StoredAngles

MAX_MEASURED_POSES = 10_000

_Direction = Annotated[float, Field(ge=-2.0, le=2.0)]
_Covariance = Annotated[float, Field(ge=-1e18, le=1e18)]
Rotation = Annotated[
    list[Annotated[list[_Direction], Field(min_length=3, max_length=3)]],
    Field(min_length=3, max_length=3),
]
Covariance = Annotated[
    list[Annotated[list[_Covariance], Field(min_length=6, max_length=6)]],
    Field(min_length=6, max_length=6),
]
_POSITION = "The probe or reflector in the instrument's frame: x, y, z, mm."
_ROTATION = (
    "3 x 3, right-handed and orthonormal to 1e-5: the probe's axes in the instrument's frame, by columns. Null where "
    "the instrument gives positions alone."
)
_COVARIANCE = (
    "6 x 6: x, y, z (mm), then a small rotation (rad) w with R_true = exp(w) R_measured, all in the instrument's "
    "frame. "
    "Null where nothing is known; the last three rows and columns are not read where rotation is null."
)
_CYCLE = "Which visit to the pose this is; null: another reading than all others of the pose."


class MeasuredPoseWrite(RequestModel):
    """One reading of an instrument at a pose of the robot."""

    pose_id: PoseIdField
    cycle: Annotated[Annotated[int, Field(ge=1, le=MAX_CYCLE)] | None, Field(description=_CYCLE)] = None
    joint_angles_deg: StatedAngles = None
    position_mm: Annotated[list[Coordinate], Field(min_length=3, max_length=3, description=_POSITION)]
    rotation: Annotated[Rotation | None, Field(description=_ROTATION)] = None
    covariance: Annotated[Covariance | None, Field(description=_COVARIANCE)] = None


MeasuredPoseList = Annotated[list[MeasuredPoseWrite], Field(max_length=MAX_MEASURED_POSES)]


class MeasuredPoseRead(ResponseModel):
    """One reading as stored; analyses name it by its id."""

    id: Annotated[str, Field(description="Id of the measured pose; opaque, made by the server.")]
    pose_id: PoseId
    cycle: Annotated[int | None, Field(description=_CYCLE)]
    joint_angles_deg: StoredAngles
    position_mm: Annotated[list[float], Field(min_length=3, max_length=3, description=_POSITION)]
    rotation: Annotated[list[list[float]] | None, Field(description=_ROTATION)]
    covariance: Annotated[list[list[float]] | None, Field(description=_COVARIANCE)]


class MeasuredPosePage(StoredPage):
    """One page of measured poses."""

    items: Annotated[list[MeasuredPoseRead], Field(description="Measured poses, oldest first.")]


class MeasuredPosesDeleted(ResponseModel):
    """What was deleted."""

    deleted: int = Field(description="How many measured poses were deleted.", examples=[30])
