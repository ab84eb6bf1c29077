"""Poses and measurements as JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

from app.api.schemas.common import (
    Angle,
    Coordinate,
    JointAngles,
    PoseTag,
    RequestModel,
    ResponseModel,
    Sha256,
    Text,
)

MeasurementStatus = Literal["queued", "running", "succeeded", "failed"]


class PoseWrite(RequestModel):
    """What the robot was told; everything may be unknown."""

    position_mm: Annotated[list[Coordinate], Field(min_length=3, max_length=3)] | None = None
    roll_deg: Angle | None = None
    pitch_deg: Angle | None = None
    yaw_deg: Angle | None = None
    joint_angles_deg: JointAngles | None = None
    approach: Text | None = None


class PoseItem(PoseWrite):
    """One pose of a bulk list."""

    pose_id: PoseTag


PoseList = Annotated[list[PoseItem], Field(max_length=100_000)]


class PoseRead(ResponseModel):
    pose_id: str
    position_mm: list[float] | None
    roll_deg: float | None
    pitch_deg: float | None
    yaw_deg: float | None
    joint_angles_deg: list[float] | None
    approach: str | None


class PosePage(ResponseModel):
    items: list[PoseRead]
    next_cursor: str | None


class ImageName(RequestModel):
    """An image by the pose it was taken at and its hash."""

    pose_id: PoseTag
    sha256: Sha256


class ImageList(RequestModel):
    images: list[ImageName]


class MissingImages(ResponseModel):
    missing: list[ImageName]


class FailureRead(ResponseModel):
    """Why an image gave no calibration, and what to do about it."""

    code: str
    detail: str
    advice: str | None


class AdvisoryRead(ResponseModel):
    code: str
    detail: str
    advice: str | None


class IntrinsicsRead(ResponseModel):
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float


class DistortionRead(ResponseModel):
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float


class CameraUncertainty(ResponseModel):
    """Standard uncertainties; 0 where the parameter was given."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float


class PoseUncertainty(ResponseModel):
    x_mm: float
    y_mm: float
    z_mm: float
    roll_deg: float
    pitch_deg: float
    yaw_deg: float


class CameraPoseRead(ResponseModel):
    """The camera in the target frame; covariances in mm and rad."""

    position_mm: list[float]
    rotation: list[list[float]]
    roll_deg: float
    pitch_deg: float
    yaw_deg: float
    standard_uncertainty: PoseUncertainty
    covariance: list[list[float]]
    conditional_covariance: list[list[float]]


class ReprojectionRead(ResponseModel):
    rms_px: float
    mean_px: float
    std_px: float
    max_px: float
    points: int
    rejected: int


class ObservabilityRead(ResponseModel):
    focal_relative_uncertainty: float
    condition_number: float
    tilt_deg: float
    prior_dominated: list[str]
    pose_ambiguity_ratio: float | None = Field(
        default=None,
        description="Least squared residuals over those of the second pose, whose tilt is mirrored about the line of "
        "sight: 0 to 1, at 1 the image does not tell the two apart. Null where there is no second minimum.",
    )


class CalibrationRead(ResponseModel):
    """One image, calibrated."""

    estimator: str
    start: str
    image_width_px: int
    image_height_px: int
    intrinsics: IntrinsicsRead
    distortion: DistortionRead
    standard_uncertainty: CameraUncertainty
    T_camera_target: list[list[float]]
    pose: CameraPoseRead
    reprojection: ReprojectionRead
    observability: ObservabilityRead
    warnings: list[AdvisoryRead]


class GridPointRead(ResponseModel):
    column: int
    row: int
    u_px: float
    v_px: float
    standard_uncertainty_px: float
    residual_u_px: float | None
    residual_v_px: float | None
    used: bool | None


class CaptureQualityRead(ResponseModel):
    """How well the picture was taken, where the target is; a figure is null where the picture does not tell it."""

    edge_width_px: float | None = Field(description="10-90 % rise distance of the sharpest edges.")
    motion_blur_px: float | None = Field(
        description="Length of the uniform motion that would widen edges as much more in one direction than across it."
    )
    motion_blur_direction_deg: float | None = Field(
        description="That direction, from u toward v, from 0 to 180."
    )
    saturated_fraction: float | None = Field(description="Share of the target's white at the sensor's top.")
    clipped_fraction: float | None = Field(description="Share of the target's black at the sensor's bottom.")
    contrast: float | None = Field(description="White less black, as a fraction of full scale.")
    coverage_fraction: float = Field(description="Share of the picture within the grid points' outline.")
    tilt_deg: float | None = Field(
        description="Angle between the target's normal and the line of sight to its middle, for a usual lens."
    )
    advice: list[AdvisoryRead] = Field(
        description="What would make a better picture, the most worthwhile first; empty for a good one."
    )


class MeasurementRead(ResponseModel):
    """One image and what came of it of one target.

    An image uploaded without `target_id` to a session with several targets becomes a measurement for each target that
    it shows. Until it is searched, and where it shows none, its measurement's `target_id` is null.
    """

    id: str
    session_id: str
    pose_id: str
    cycle: int | None
    target_id: str | None
    siblings: list[str] = Field(
        description="The measurements of the same image at the same pose, of other targets; oldest first."
    )
    focus_group: str
    joint_angles_deg: list[float] | None
    captured_at: datetime | None
    received_at: datetime
    finished_at: datetime | None
    sha256: str
    filename: str | None
    bytes: int
    status: MeasurementStatus
    attempts: int
    duration_ms: float | None
    failure: FailureRead | None
    calibration: CalibrationRead | None
    origin: Literal["known", "turned", "unknown"] | None = Field(
        description="How far the picture tells which grid point is (0, 0): `known` for sure; `turned` but for turns of "
        "the whole grid that look the same, one of which was chosen; `unknown` where part of a grid is seen that may "
        "be any part. Null where no points were found, or before this was kept."
    )
    capture_quality: CaptureQualityRead | None
    points: list[GridPointRead] | None


class MeasurementPage(ResponseModel):
    items: list[MeasurementRead]
    next_cursor: str | None
