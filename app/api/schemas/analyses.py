"""Analyses of a session as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from app.api.schemas.common import ResponseModel
from app.api.schemas.measurements import AdvisoryRead, CameraUncertainty, DistortionRead, IntrinsicsRead

Estimator = Literal["pooled", "pooled_free_focal", "per_image", "per_image_fixed_pp", "given"]

Source = Literal["images", "measured_poses"]
Verdict = Literal["robot", "instrument_limited", "below_detection", "too_few_cycles"]

Matrix = list[list[float]]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Interval = Annotated[list[float], Field(min_length=2, max_length=2)]
_CHI = Field(
    description="Squared residuals over the grid points' stated uncertainties, per degree of freedom: about 1 where "
    "camera and print are as the model has them."
)


class ImageResidual(ResponseModel):
    """An image and the root mean square of its residual distances."""

    measurement_id: str
    rms_px: float


class GroupIntrinsics(ResponseModel):
    """The camera of one focus group; with the estimators that calibrate every image by itself, the mean over images."""

    focus_group: str
    images: Annotated[int, Field(description="How many images it comes from.")]
    intrinsics: IntrinsicsRead
    distortion: DistortionRead
    standard_uncertainty: CameraUncertainty
    reduced_chi2: Annotated[float, _CHI]


class GroupCalibration(GroupIntrinsics):
    """The camera of one focus group, with its covariance and the images it explains worst."""

    covariance: Annotated[
        Matrix,
        Field(description="9 x 9, in the order fx, fy, cx, cy (px), k1, k2, p1, p2, k3; 0 where held fixed."),
    ]
    worst: list[ImageResidual]


class TargetTransform(ResponseModel):
    """How two targets lie to one another, from images that show both."""

    from_target_id: str
    to_target_id: str
    T_from_to: Annotated[
        Matrix, Field(description="4 x 4, mm: maps points of the second target into the first's frame.")
    ]
    covariance: Annotated[
        Matrix,
        Field(
            description="6 x 6: x, y, z (mm), then a small rotation (rad) from the left, in the first target's frame."
        ),
    ]
    images: int


class AnalysisHead(ResponseModel):
    """What every analysis says of itself."""

    session_id: str
    estimator: Estimator
    inputs_sha256: Annotated[
        str,
        Field(
            description="Hash of everything the analysis was computed from: images by pose, cycle, hash and metadata, "
            "commanded poses, targets, settings and the program's version; no ids, no times."
        ),
    ]
    core_version: str
    pending: Annotated[
        int, Field(description="Images not measured yet, which this analysis does not wait for.")
    ]


class ShapeMeasure(ResponseModel):
    """A number with its standard uncertainty."""

    value: float
    standard_uncertainty: float


class ShapeDeparture(ResponseModel):
    """How far grid points are from their places, over all points."""

    rms_mm: float
    standard_uncertainty_mm: float
    noise_mm: Annotated[float, Field(description="The rms that the estimate's own doubt makes of it.")]
    largest_mm: float
    significant: Annotated[
        bool, Field(description="Whether noise alone would give so much once in a thousand times at most.")
    ]


class ShapePoint(ResponseModel):
    """One grid point's departure from its place, in the target frame."""

    column: int
    row: int
    departure_mm: Vector
    standard_uncertainty_mm: Vector


class TargetShape(ResponseModel):
    """The target as it is: departures from the ideal grid after the best move, turn and scaling of the whole."""

    target_id: str
    focus_group: Annotated[str, Field(description="Whose images it comes from.")]
    images: int
    directions: Annotated[
        int,
        Field(description="From which the images show it that differ by 5° and are tilted by 10° or more."),
    ]
    applied: Annotated[
        bool,
        Field(
            description="Whether the cameras are those before the refined target: where anything is significant."
        ),
    ]
    rms_before_px: Annotated[float, Field(description="Residual distances with the target taken as perfect.")]
    rms_px: float
    reduced_chi2: Annotated[float, _CHI]
    in_plane: ShapeDeparture
    out_of_plane: ShapeDeparture
    bow_x_mm: Annotated[
        ShapeMeasure,
        Field(description="How far the middle of a row stands out along z (into the board) from its ends."),
    ]
    bow_y_mm: Annotated[ShapeMeasure, Field(description="The same of a column.")]
    twist_mm: Annotated[
        ShapeMeasure, Field(description="How far the corners stand out of the plane, two up and two down.")
    ]
    aspect: Annotated[ShapeMeasure, Field(description="Length along x over length along y, less 1.")]
    shear_deg: Annotated[ShapeMeasure, Field(description="By how much less than 90° the axes meet.")]
    points: list[ShapePoint]


class IntrinsicsAnalysis(AnalysisHead):
    """The camera of a session, focus group by focus group."""

    groups: list[GroupCalibration]
    target_transforms: list[TargetTransform]
    target_shape: Annotated[
        TargetShape | None, Field(description="With `refine_target`: the target's own shape.")
    ]
    warnings: list[AdvisoryRead]


class PoseMean(ResponseModel):
    """The mean of the images that count: the camera in the target frame, R = Rz(yaw) Ry(pitch) Rx(roll)."""

    position_mm: Vector | None
    roll_deg: float | None
    pitch_deg: float | None
    yaw_deg: float | None


class PoseFigures(ResponseModel):
    """One figure of the position as a whole, one an axis, one a rotation angle; null where it is not known."""

    position_mm: float | None
    x_mm: float | None
    y_mm: float | None
    z_mm: float | None
    roll_deg: float | None
    pitch_deg: float | None
    yaw_deg: float | None


class PoseIntervals(ResponseModel):
    """For each figure [low, high]: between which it lies at the confidence level."""

    position_mm: Interval | None
    x_mm: Interval | None
    y_mm: Interval | None
    z_mm: Interval | None
    roll_deg: Interval | None
    pitch_deg: Interval | None
    yaw_deg: Interval | None


class ExcludedImage(ResponseModel):
    """An image that does not count, and why."""

    measurement_id: str
    code: str
    detail: str


class PoseRepeatability(ResponseModel):
    """One pose by ISO 9283:1998."""

    pose_id: str
    n: Annotated[int, Field(description="Images that count: the cycles of the standard.")]
    mean: PoseMean
    repeatability: Annotated[
        PoseFigures,
        Field(
            description="RP_l = mean distance from the mean position + 3 S of the distances; 3 S for each axis and "
            "angle (7.2.2). In the target frame. Null below two cycles."
        ),
    ]
    interval: PoseIntervals
    noise_floor: Annotated[
        PoseFigures,
        Field(
            description="The reading that the noise of these images alone would give on a motionless robot."
        ),
    ]
    corrected: Annotated[
        PoseFigures,
        Field(description="The reading with the noise's covariance taken off: the robot's own part."),
    ]
    accuracy: Annotated[
        PoseFigures | None,
        Field(
            description="Attained less commanded (7.2.1), in the robot's base frame, with the frames tied by the other "
            "poses; null where they cannot be tied, for the reason in warnings."
        ),
    ]
    verdict: Annotated[
        Verdict,
        Field(
            description="What the reading of the position speaks of: the robot, or the instrument too; "
            "`below_detection` where it is less than the noise alone would give."
        ),
    ]
    used: list[str]
    excluded: list[ExcludedImage]
    with_excluded: Annotated[
        PoseFigures | None,
        Field(
            description="`repeatability` with the outliers in `excluded` counted; null where there are none."
        ),
    ]


class DriftBlock(ResponseModel):
    """Ten consecutive cycles or more."""

    first_cycle: int
    last_cycle: int
    mean_position_mm: Vector
    repeatability_mm: float


class PoseDrift(ResponseModel):
    """How a pose moved from its first block of cycles to its last (7.6)."""

    pose_id: str
    shift_mm: Annotated[Vector, Field(description="Of the mean position, in the target frame.")]
    shift_deg: Annotated[Vector | None, Field(description="Rotation vector of the mean orientation.")]
    repeatability_change_mm: Annotated[
        float, Field(description="dRP_l: between the first and the last block.")
    ]
    blocks: list[DriftBlock]


class Drift(ResponseModel):
    """Drift over the cycles, for poses with at least two blocks of ten numbered cycles."""

    poses: list[PoseDrift]


class PoseDistance(ResponseModel):
    """The way between two poses by ISO 9283:1998, 7.3: of the measured point, within each cycle that visits both."""

    from_pose_id: str
    to_pose_id: str
    n: Annotated[int, Field(description="Cycles that visit both poses once.")]
    mean_mm: float
    standard_uncertainty_mm: Annotated[
        float | None,
        Field(
            description="Of the mean: its scatter over the cycles and, for images, what the shared lens and the "
            "print's scale leave open; another instrument's common errors are not known."
        ),
    ]
    commanded_mm: Annotated[
        float | None,
        Field(
            description="Null where no positions were commanded, or other orientations at the two ends: then the "
            "measured point does not move as the commanded one."
        ),
    ]
    accuracy_mm: Annotated[float | None, Field(description="AD: attained less commanded (7.3.2).")]
    repeatability_mm: Annotated[float | None, Field(description="RD = 3 S of the distance (7.3.3).")]
    interval_mm: Annotated[Interval | None, Field(description="Of RD, at the confidence level.")]
    noise_floor_mm: Annotated[
        float | None,
        Field(description="The RD that the measurements' noise alone would give on a motionless robot."),
    ]


class Approach(ResponseModel):
    """One direction from which a commanded pose was approached."""

    approach: str
    pose_ids: list[str]
    n: int


class ApproachVariation(ResponseModel):
    """One commanded pose approached from several directions (ISO 9283:1998, 7.2.3)."""

    directions: list[Approach]
    variation: Annotated[
        PoseFigures,
        Field(
            description="vAP: the largest difference between the directions' mean poses: of the position its length, "
            "else the absolute difference on each axis and angle."
        ),
    ]
    noise_floor: Annotated[
        PoseFigures,
        Field(
            description="The expected reading if the direction made no difference, from the cycles' own scatter; null "
            "where no direction has two cycles."
        ),
    ]


class RepeatabilityAnalysis(AnalysisHead):
    """Pose repeatability of a session, pose by pose in natural order."""

    source: Source
    confidence_level: float
    poses: list[PoseRepeatability]
    intrinsics: list[GroupIntrinsics]
    drift: Drift | None
    distances: Annotated[
        list[PoseDistance] | None,
        Field(
            description="Between all pairs of up to ten poses, of more between each and the next; null where no two "
            "have two numbered cycles in common."
        ),
    ]
    approach_variation: Annotated[
        list[ApproachVariation] | None,
        Field(
            description="Of every commanded pose that stands under several pose ids with different `approach`; null "
            "where there is none."
        ),
    ]
    warnings: list[AdvisoryRead]
