"""The comparison of methods as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.analyses.common import AnalysisHead
from app.api.schemas.analyses.figures import RepeatabilityFigures
from app.api.schemas.camera import DistortionRead, IntrinsicsRead
from app.api.schemas.common import AdvisoryRead, FailureRead, ResponseModel
from app.api.schemas.fields import PoseId

ComparisonMethod = TypeAliasType(
    "ComparisonMethod",
    Annotated[
        Literal[
            "proposed_nullspace",
            "proposed_vanishing_point",
            "zhang",
            "opencv_single_image",
            "tsai",
            "dlt",
            "five_points",
            "lines",
            "aruco_marker",
            "aruco_board",
            "pooled",
        ],
        Field(description="A method of calibration. docs/comparison.md describes each."),
    ],
)
MethodField = Annotated[
    ComparisonMethod,
    Field(
        description="`proposed_nullspace`, `proposed_vanishing_point`: this program's, by the start of the fit; "
        "`pooled`: its camera of all images; the others as published, or as OpenCV has them. docs/comparison.md "
        "describes each."
    ),
]
CameraOf = TypeAliasType(
    "CameraOf",
    Annotated[
        Literal["each_image", "all_images", "session", "pooled"],
        Field(description="Whose camera a method uses."),
    ],
)


class ImagesFailure(FailureRead):
    """Images that a method has no answer for: one reason, with the first one's figures."""

    image_count: Annotated[int, Field(description="How many images it concerns.")]
    measurement_ids: Annotated[list[str], Field(description="The first five of them.")]


class MethodWarning(AdvisoryRead):
    """A warning about a method's results."""

    image_count: Annotated[int, Field(description="How many images it concerns.")]


class ResidualDistances(ResponseModel):
    """Of the distances between points observed and points predicted, over all points of the images calibrated."""

    rms_px: Annotated[float, Field(description="Root mean square of the distances, px.")]
    mean_px: Annotated[float, Field(description="Mean of the distances, px.")]
    std_px: Annotated[float, Field(description="Standard deviation of the distances, px.")]
    max_px: Annotated[float, Field(description="Largest of the distances, px.")]
    points: Annotated[int, Field(description="How many points, over all images that the method calibrated.")]


class CameraDeviation(ResponseModel):
    """Standard deviation over images."""

    fx_px: Annotated[float, Field(description="Standard deviation of `fx_px` over images, px.")]
    fy_px: Annotated[float, Field(description="Standard deviation of `fy_px` over images, px.")]
    cx_px: Annotated[float, Field(description="Standard deviation of `cx_px` over images, px.")]
    cy_px: Annotated[float, Field(description="Standard deviation of `cy_px` over images, px.")]
    k1: Annotated[float, Field(description="Standard deviation of `k1` over images, dimensionless.")]
    k2: Annotated[float, Field(description="Standard deviation of `k2` over images, dimensionless.")]
    p1: Annotated[float, Field(description="Standard deviation of `p1` over images, dimensionless.")]
    p2: Annotated[float, Field(description="Standard deviation of `p2` over images, dimensionless.")]
    k3: Annotated[float, Field(description="Standard deviation of `k3` over images, dimensionless.")]


class MethodCalibration(ResponseModel):
    """A row of the paper's Table II."""

    method: MethodField
    camera_of: Annotated[
        CameraOf,
        Field(
            description="Whose camera it is: each image's own, one for all images, or a given one: the session's "
            "intrinsics, else the pooled ones."
        ),
    ]
    calibrated: Annotated[int, Field(description="Images the method has an answer for.")]
    failed: Annotated[int, Field(description="Images the method has no answer for; `failures` says why.")]
    reprojection: Annotated[
        ResidualDistances | None,
        Field(
            description="Residual distances of the images calibrated, px; null where there are no such images."
        ),
    ]
    intrinsics: Annotated[
        IntrinsicsRead | None, Field(description="The mean over images, or the one camera of all.")
    ]
    distortion: Annotated[
        DistortionRead | None,
        Field(
            description="The same of the distortion; 0 where the method models none, null where no image is calibrated."
        ),
    ]
    standard_deviation: Annotated[
        CameraDeviation | None,
        Field(description="Over images that have a camera each, two or more; null otherwise."),
    ]
    failures: Annotated[
        list[ImagesFailure], Field(description="Images that the method has no answer for, by reason.")
    ]
    warnings: Annotated[
        list[MethodWarning], Field(description="About the method's results, one for each code.")
    ]
    failure: Annotated[
        FailureRead | None, Field(description="Why the method has no answer at all; the figures are null.")
    ]


class MethodPoseRepeatability(ResponseModel):
    """One pose by one method."""

    pose_id: PoseId
    cycles: Annotated[int, Field(description="Images that count: the cycles of the standard.")]
    repeatability: Annotated[
        RepeatabilityFigures,
        Field(
            description="RP_l and 3 S of ISO 9283:1998, 7.2.2, from this method's poses; null below two images."
        ),
    ]
    noise_floor: Annotated[
        RepeatabilityFigures | None,
        Field(
            description="What the noise alone would read on a motionless robot; null where the method states no "
            "covariance."
        ),
    ]
    failures: Annotated[
        list[ImagesFailure],
        Field(description="Images of the pose that do not count, since they are not calibrated."),
    ]
    failure: Annotated[
        FailureRead | None,
        Field(description="Why the method has no figures for this pose; null where it has."),
    ]


class MethodRepeatability(ResponseModel):
    """A row of the paper's Table III."""

    method: MethodField
    poses: Annotated[
        list[MethodPoseRepeatability], Field(description="Pose by pose in natural order, P2 before P10.")
    ]
    failure: Annotated[
        FailureRead | None, Field(description="Why the method has no answer for any pose; null where it has.")
    ]


class ComparisonAnalysis(AnalysisHead):
    """Every method on the same images of a session."""

    focus_group: Annotated[str, Field(description="The one compared: that of the most images.")]
    image_count: Annotated[int, Field(description="How many images every method was given.")]
    calibrations: Annotated[
        list[MethodCalibration],
        Field(description="The paper's Table II: residuals and cameras, one row for each method."),
    ]
    repeatabilities: Annotated[
        list[MethodRepeatability],
        Field(description="The paper's Table III: repeatability, one row for each method."),
    ]
