"""A session's repeatability by ISO 9283 as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.analyses.budget import BudgetInput, BudgetTotal
from app.api.schemas.analyses.common import EstimatedAnalysis, ExcludedRead, SourceField, Vector
from app.api.schemas.analyses.figures import (
    AccuracyAcceptance,
    PoseAccuracy,
    RepeatabilityAcceptance,
    RepeatabilityFigures,
    RepeatabilityIntervals,
)
from app.api.schemas.analyses.intrinsics import GroupIntrinsics
from app.api.schemas.analyses.performance import (
    ApproachVariation,
    BurstsRead,
    Drift,
    PoseBurst,
    PoseDistance,
    WitnessRead,
)
from app.api.schemas.analyses.steadiness import Steadiness
from app.api.schemas.common import ResponseModel, Share
from app.api.schemas.fields import PITCH, ROLL, YAW, MeasuredPoseOrNull, MeasurementOrNull, PoseId

Verdict = TypeAliasType(
    "Verdict",
    Annotated[
        Literal["robot", "instrument_limited", "below_detection", "not_steady", "too_few_cycles"],
        Field(description="What a pose's figures are of: the robot, or the instrument."),
    ],
)


class PoseMean(ResponseModel):
    """The mean of the images that count: the camera in the target frame, R = Rz(yaw) Ry(pitch) Rx(roll)."""

    position_mm: Annotated[
        Vector | None,
        Field(
            description="Mean position x, y, z, mm: of the camera in the target frame, or of another "
            "instrument's probe "
            "in that instrument's frame. Null where no cycle counts."
        ),
    ]
    roll_deg: Annotated[float | None, Field(description=f"{ROLL} Null where it is not known.")]
    pitch_deg: Annotated[float | None, Field(description=f"{PITCH} Null where it is not known.")]
    yaw_deg: Annotated[float | None, Field(description=f"{YAW} Null where it is not known.")]


class OutlierRead(ResponseModel):
    """A cycle that the pose's scatter does not explain; it counts all the same."""

    measurement_id: MeasurementOrNull
    measured_pose_id: MeasuredPoseOrNull
    cycle: Annotated[int | None, Field(description="The cycle's number as stated with it; null: not stated.")]
    code: Annotated[str, Field(description="`position_outlier` or `orientation_outlier`.")]
    distance_mm: Annotated[
        float, Field(description="Distance of its position from the pose's median position, mm.")
    ]
    detail: Annotated[str, Field(description="How far it lies, and how far most of the others.")]


class FigureVerdict(ResponseModel):
    """What one figure is of."""

    figure: Annotated[str, Field(description="Its key in `repeatability`, such as `rp_x_mm`.")]
    verdict: Annotated[Verdict, Field(description="What the figure is of: the robot, or the instrument too.")]


class OrientationScatter(ResponseModel):
    """Scatter of orientation in two other forms, as 3 S."""

    rotation_vector_deg: Annotated[
        Vector,
        Field(
            description="Of the rotation vectors about the mean orientation, along the target frame's x, y, z, "
            "degrees: without any singularity."
        ),
    ]
    roll_pitch_yaw_deg: Annotated[
        Vector,
        Field(description="Of each cycle's roll, pitch, yaw as such, the standard's own wording, degrees."),
    ]


class PoseRepeatability(ResponseModel):
    """One pose by ISO 9283:1998."""

    pose_id: PoseId
    cycles: Annotated[
        int,
        Field(
            description="Stops that count, the cycles of the standard; the images of a burst are one, their mean."
        ),
    ]
    mean: Annotated[PoseMean, Field(description="The mean of the cycles that count.")]
    repeatability: Annotated[
        RepeatabilityFigures,
        Field(
            description="Over all cycles that the instrument measured, outliers included. In the target frame. Null "
            "below two cycles."
        ),
    ]
    interval: Annotated[
        RepeatabilityIntervals, Field(description="Of `repeatability`, at the confidence level.")
    ]
    noise_floor: Annotated[
        RepeatabilityFigures,
        Field(
            description="The reading that the noise of these images alone would give on a motionless robot."
        ),
    ]
    corrected: Annotated[
        RepeatabilityFigures,
        Field(description="The reading with the noise's covariance taken off: the robot's own part."),
    ]
    corrected_interval: Annotated[
        RepeatabilityIntervals,
        Field(
            description="Of `corrected`; null for the position where the noise floor exceeds half of the reading, "
            "since no known interval keeps its level there, and without the instrument's covariances."
        ),
    ]
    without_outliers: Annotated[
        RepeatabilityFigures | None,
        Field(description="`repeatability` of the cycles that are not in `outliers`; null without outliers."),
    ]
    outliers: Annotated[
        list[OutlierRead],
        Field(description="Cycles that the scatter of the others does not explain; they count."),
    ]
    including_degraded: Annotated[
        RepeatabilityFigures | None,
        Field(
            description="`repeatability` with the cycles that do not count because their images are degraded "
            "(`image_degraded` in `excluded`); null without such cycles."
        ),
    ]
    accuracy: Annotated[
        PoseAccuracy | None,
        Field(
            description="Attained less commanded (7.2.1), in the robot's base frame, with the frames tied by the "
            "commanded poses (best fit, studentised by its leverage); null where they cannot be tied, for the reason "
            "in warnings."
        ),
    ]
    verdict: Annotated[
        Verdict,
        Field(
            description="What the reading of the position speaks of: the robot, or the instrument too; "
            "`below_detection` where it is less than the noise alone would give, `not_steady` where the cycles are not "
            "independent and identically distributed (`steadiness`)."
        ),
    ]
    verdicts: Annotated[
        list[FigureVerdict],
        Field(description="The same for each figure that is known; `verdict` is that of the position."),
    ]
    orientation_scatter: Annotated[
        OrientationScatter | None,
        Field(
            description="Scatter of orientation in other forms; null without orientations or below two cycles."
        ),
    ]
    within_stops: Annotated[
        PoseBurst | None, Field(description="What images within stops scatter; null without bursts.")
    ]
    measurement_ids: Annotated[
        list[str],
        Field(description="Images that count, in the order of the cycles; of a burst all."),
    ]
    measured_pose_ids: Annotated[
        list[str],
        Field(description="What another instrument measured and counts, in the order of the cycles."),
    ]
    excluded: Annotated[
        list[ExcludedRead], Field(description="Images, or measured poses, that do not count, and why.")
    ]


class RepeatabilityAnalysis(EstimatedAnalysis):
    """Pose repeatability of a session, pose by pose in natural order."""

    source: SourceField
    confidence_level: Annotated[
        Share, Field(description="Probability that an interval contains its figure, such as 0.95.")
    ]
    poses: Annotated[
        list[PoseRepeatability], Field(description="Pose by pose in natural order, P2 before P10.")
    ]
    groups: Annotated[
        list[GroupIntrinsics],
        Field(description="The camera of each focus group; empty for another instrument."),
    ]
    steadiness: Annotated[
        Steadiness,
        Field(description="Whether the cycles are steady, by all poses jointly."),
    ]
    witness: Annotated[
        WitnessRead | None,
        Field(description="How the pose named by `witness` moved; null: none is named."),
    ]
    drift: Annotated[
        Drift | None,
        Field(
            description="How poses moved over the cycles (7.6); null where no pose has two blocks of ten cycles."
        ),
    ]
    bursts: Annotated[
        BurstsRead | None,
        Field(description="What images scatter within their stops, of all poses; null without bursts."),
    ]
    acceptance: Annotated[
        RepeatabilityAcceptance | None,
        Field(
            description="RP_l compared with the robot's data sheet; null where it states no repeatability."
        ),
    ]
    accuracy_acceptance: Annotated[
        AccuracyAcceptance | None,
        Field(
            description="AP_p compared with the robot's data sheet; null where it states none, or no pose has it."
        ),
    ]
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
            description="For every commanded pose that has several pose ids with different `approach`; null "
            "without such poses."
        ),
    ]
    budget: Annotated[
        list[BudgetInput],
        Field(
            description="What the uncertainty of each headline figure is made of (GUM), a row for each input: of up to "
            "forty poses, those of the largest RP_l, and of the distances."
        ),
    ]
    budget_totals: Annotated[
        list[BudgetTotal], Field(description="The combined uncertainty of each of these figures.")
    ]
