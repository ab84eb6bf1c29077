"""The comparison of methods as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from app.api.schemas.analyses import PoseFigures
from app.api.schemas.common import ResponseModel
from app.api.schemas.measurements import AdvisoryRead, DistortionRead, FailureRead, IntrinsicsRead

Method = Literal[
    "proposed_nullspace",
    "proposed_vanishing_point",
    "zhang",
    "opencv_single_image",
    "tsai",
    "dlt",
    "aruco_marker",
    "aruco_board",
    "pooled",
]


class ImagesFailure(FailureRead):
    """Images that a method has no answer for: one reason, with the first one's figures."""

    images: int
    measurement_ids: Annotated[list[str], Field(description="The first five of them.")]


class MethodRemark(AdvisoryRead):
    """What a method says of its answers."""

    images: Annotated[int, Field(description="How many of them it concerns.")]


class ResidualDistances(ResponseModel):
    """Of the distances between points observed and points predicted, over all points of the images calibrated."""

    rms_px: float
    mean_px: float
    std_px: float
    max_px: float
    points: int


class CameraSpread(ResponseModel):
    """Standard deviation over images."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    k1: float
    k2: float
    p1: float
    p2: float
    k3: float


class MethodCalibration(ResponseModel):
    """A row of the paper's Table II."""

    method: Method
    camera: Annotated[
        Literal["each_image", "all_images", "session", "pooled"],
        Field(
            description="Whose camera it is: each image's own, one for all images, or a given one: the session's "
            "intrinsics, else the pooled ones."
        ),
    ]
    calibrated: Annotated[int, Field(description="Images the method has an answer for.")]
    failed: int
    reprojection: ResidualDistances | None
    intrinsics: Annotated[
        IntrinsicsRead | None, Field(description="The mean over images, or the one camera of all.")
    ]
    distortion: DistortionRead | None
    spread: Annotated[
        CameraSpread | None,
        Field(description="Over images that have a camera each, two or more; null otherwise."),
    ]
    failures: Annotated[list[ImagesFailure], Field(description="Of single images, by reason.")]
    remarks: list[MethodRemark]
    failure: Annotated[
        FailureRead | None, Field(description="Why the method has no answer at all; the figures are null.")
    ]


class MethodPoseRepeatability(ResponseModel):
    """One pose by one method."""

    pose_id: str
    n: Annotated[int, Field(description="Images that count: the cycles of the standard.")]
    repeatability: Annotated[
        PoseFigures,
        Field(
            description="RP_l and 3 S of ISO 9283:1998, 7.2.2, from this method's poses; null below two images."
        ),
    ]
    noise_floor: Annotated[
        PoseFigures | None,
        Field(
            description="What the noise alone would read on a motionless robot; null where the method states no "
            "covariance."
        ),
    ]
    failures: Annotated[
        list[ImagesFailure],
        Field(description="Images of the pose that do not count: not calibrated, or outliers."),
    ]
    failure: FailureRead | None


class MethodRepeatability(ResponseModel):
    """A row of the paper's Table III."""

    method: Method
    poses: list[MethodPoseRepeatability]
    failure: FailureRead | None


class ComparisonAnalysis(ResponseModel):
    """Every method on the same images of a session."""

    session_id: str
    inputs_sha256: Annotated[
        str, Field(description="Hash of everything the analysis was computed from; no ids, no times.")
    ]
    core_version: str
    pending: Annotated[
        int, Field(description="Images not measured yet, which this analysis does not wait for.")
    ]
    focus_group: Annotated[str, Field(description="The one compared: that of the most images.")]
    images: Annotated[int, Field(description="How many images every method was given.")]
    calibration: list[MethodCalibration]
    repeatability: list[MethodRepeatability]
    warnings: list[AdvisoryRead]
