"""Targets, robots, sessions and keys as JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

from app.api.schemas.common import (
    MAX_LENGTH_MM,
    Angle,
    Coordinate,
    Identifier,
    PositiveLength,
    RequestModel,
    ResponseModel,
    Text,
)

TargetKind = Literal["chessboard", "charuco", "circles", "asymmetric_circles", "aprilgrid"]
Scope = Literal["read", "upload", "admin"]
Span = Annotated[int, Field(ge=2, le=500)]
Pitch = Annotated[
    float, Field(ge=1e-6, le=MAX_LENGTH_MM)
]  # a nanometre: a smaller one is a slip, and squares to nothing
PixelCoordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
FocalLength = Annotated[float, Field(gt=0, le=1e7)]
DistortionCoefficient = Annotated[float, Field(ge=-1e6, le=1e6)]


class TargetCreate(RequestModel):
    """A printed target."""

    name: Text
    kind: TargetKind
    columns: Span
    rows: Span
    pitch_mm: Pitch
    marker_mm: PositiveLength | None = None
    dictionary: Annotated[str, Field(max_length=64, pattern=r"^[A-Za-z0-9_]+$")] | None = None
    legacy_layout: bool = False
    pitch_standard_uncertainty_mm: Annotated[float, Field(ge=0, le=1e6)] | None = None


class TargetRead(ResponseModel):
    """A printed target as stored."""

    id: str
    name: str
    kind: TargetKind
    columns: int
    rows: int
    pitch_mm: float
    marker_mm: float | None
    dictionary: str | None
    legacy_layout: bool
    pitch_standard_uncertainty_mm: float | None
    created_at: datetime


class TargetPage(ResponseModel):
    items: list[TargetRead]
    next_cursor: str | None


class Joint(RequestModel):
    """Classic (distal) Denavit-Hartenberg parameters of one joint."""

    a_mm: Coordinate
    alpha_deg: Angle
    d_mm: Coordinate
    theta_offset_deg: Angle = 0.0
    name: Annotated[
        Text | None, Field(description="The maker's name of the joint, for files of other programs.")
    ] = None
    lower_deg: Annotated[
        Angle | None,
        Field(description="The joint turns no further down; together with `upper_deg`, or neither."),
    ] = None
    upper_deg: Angle | None = None


class RobotCreate(RequestModel):
    """A robot's nominal kinematics."""

    name: Text
    joints: Annotated[list[Joint], Field(min_length=1, max_length=12)]
    repeatability_mm: Annotated[float, Field(ge=0, le=1e6)] | None = None


class RobotRead(ResponseModel):
    id: str
    name: str
    joints: list[Joint]
    repeatability_mm: float | None


class RobotPage(ResponseModel):
    items: list[RobotRead]
    next_cursor: str | None


class SessionLens(RequestModel):
    """What the lens and the sensor say about themselves: a prior on the focal length."""

    focal_length_mm: Annotated[float, Field(gt=0, le=1e5)]
    pixel_pitch_um: Annotated[float, Field(gt=0, le=1e4)]


class SessionIntrinsics(RequestModel):
    """A camera calibrated elsewhere; images then give their pose only."""

    fx_px: FocalLength
    fy_px: FocalLength
    cx_px: PixelCoordinate
    cy_px: PixelCoordinate
    k1: DistortionCoefficient = 0.0
    k2: DistortionCoefficient = 0.0
    p1: DistortionCoefficient = 0.0
    p2: DistortionCoefficient = 0.0
    k3: DistortionCoefficient = 0.0


TargetIds = Annotated[list[Identifier], Field(min_length=1, max_length=16)]


class SessionCreate(RequestModel):
    name: Text
    target_ids: TargetIds
    robot_id: Identifier | None = None
    lens: SessionLens | None = None
    intrinsics: SessionIntrinsics | None = None


class SessionChange(RequestModel):
    """What to change of a session; fields left away stay as they are."""

    # The factories make the fields optional without allowing null; what was not sent is never looked at.
    name: Text = Field(default_factory=str)
    target_ids: TargetIds = Field(default_factory=list)
    robot_id: Identifier | None = None
    lens: SessionLens | None = None
    intrinsics: SessionIntrinsics | None = None


class Counts(ResponseModel):
    """How many measurements of a session stand where; together, all of them."""

    queued: int
    running: int
    succeeded: int
    failed: Annotated[
        int, Field(description="Of status `failed`, but for those that `already_measured` counts.")
    ]
    already_measured: Annotated[
        int,
        Field(
            description="Of status `failed` with the code `target_already_measured`: their images were measured "
            "before, as `siblings` says. Nothing is lost, and nothing is to be done."
        ),
    ]


class SessionRead(ResponseModel):
    id: str
    name: str
    target_ids: list[str]
    robot_id: str | None
    lens: SessionLens | None
    intrinsics: SessionIntrinsics | None
    created_at: datetime
    counts: Counts


class SessionPage(ResponseModel):
    items: list[SessionRead]
    next_cursor: str | None


class KeyCreate(RequestModel):
    """An API key to be made."""

    name: Text
    scope: Scope
    expires_in_days: Annotated[int, Field(ge=1, le=36500)] | None = None


class KeyRead(ResponseModel):
    """An API key without its secret."""

    id: str
    name: str
    scope: Scope
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None


class KeyCreated(KeyRead):
    """A key just made; `key` is shown this once."""

    key: str


class KeyPage(ResponseModel):
    items: list[KeyRead]
    next_cursor: str | None
