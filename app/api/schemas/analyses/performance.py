"""Drift, distances and variation over approach directions by ISO 9283 as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.analyses.common import Interval, Vector
from app.api.schemas.analyses.figures import RepeatabilityFigures, VariationFigures
from app.api.schemas.common import ResponseModel, Share
from app.api.schemas.fields import PoseId

DriftBasis = TypeAliasType(
    "DriftBasis", Annotated[Literal["time", "cycle"], Field(description="What drift is known over.")]
)
TimeSource = TypeAliasType(
    "TimeSource",
    Annotated[
        Literal["captured_at", "received_at"], Field(description="Which of an image's times drift is over.")
    ],
)


class DriftBlock(ResponseModel):
    """Ten consecutive cycles or more."""

    first_cycle: Annotated[int, Field(description="The number of the block's first cycle.")]
    last_cycle: Annotated[int, Field(description="The number of the block's last cycle.")]
    mean_position_mm: Annotated[
        Vector, Field(description="Mean position x, y, z of the block's cycles, mm, in the frame of `mean`.")
    ]
    mean_standard_uncertainty_mm: Annotated[
        Vector,
        Field(
            description="Of the mean position along x, y, z, from the cycles' scatter, mm.",
            examples=[[0.011, 0.009, 0.014]],
        ),
    ]
    rp_l_mm: Annotated[float, Field(description="RP_l of this block's cycles, mm.")]
    ap_p_mm: Annotated[
        float | None,
        Field(
            description="AP_p of this block's cycles, in the frames that tie the pose's own AP, mm; null without one."
        ),
    ]
    mean_time_h: Annotated[
        float | None,
        Field(
            description="Mean time of its images after the session's first image, h; null where not known."
        ),
    ]


class PoseDrift(ResponseModel):
    """How a pose moved from its first block of cycles to its last (7.6)."""

    pose_id: PoseId
    shift_mm: Annotated[
        Vector, Field(description="By which the mean position moved along x, y, z, in the target frame, mm.")
    ]
    shift_standard_uncertainty_mm: Annotated[
        Vector,
        Field(
            description="Of `shift_mm`, from the scatter of both blocks, mm.", examples=[[0.015, 0.013, 0.02]]
        ),
    ]
    shift_degrees_of_freedom: Annotated[
        Vector,
        Field(
            description="Of `shift_standard_uncertainty_mm`, by Welch and Satterthwaite of both blocks.",
            examples=[[17.2, 16.4, 17.9]],
        ),
    ]
    shift_distance_mm: Annotated[float, Field(description="Length of `shift_mm`, mm.", examples=[0.043])]
    shift_distance_standard_uncertainty_mm: Annotated[
        float,
        Field(
            description="Of `shift_distance_mm`: that along the shift, mm; of no shift the largest of the axes.",
            examples=[0.017],
        ),
    ]
    shift_distance_degrees_of_freedom: Annotated[
        float, Field(description="Of `shift_distance_standard_uncertainty_mm`.", examples=[19.4])
    ]
    shift_deg: Annotated[
        Vector | None,
        Field(
            description="By which the mean orientation turned, as a rotation vector, degrees; null for positions alone."
        ),
    ]
    shift_standard_uncertainty_deg: Annotated[
        Vector | None, Field(description="Of `shift_deg`, from the scatter of both blocks, degrees.")
    ]
    drp_mm: Annotated[
        float,
        Field(description="dRP_l: absolute difference of RP_l between the first block and the last, mm."),
    ]
    dap_mm: Annotated[
        float | None,
        Field(
            description="dAP_p: absolute difference of AP_p between the first block and the last, mm; null where the "
            "pose has no AP.",
            examples=[0.021],
        ),
    ]
    dap_standard_uncertainty_mm: Annotated[
        float | None,
        Field(
            description="Of `dap_mm`, from the scatter of both blocks and what the tie of the frames leaves open, mm; "
            "null where that is not known.",
            examples=[0.014],
        ),
    ]
    duration_h: Annotated[
        float | None,
        Field(description="From the mean time of the first block to that of the last, h; null: not known."),
    ]
    rate_mm_per_h: Annotated[
        Vector | None,
        Field(
            description="Slope of the position over time along x, y, z by least squares, mm/h; null: not known."
        ),
    ]
    rate_standard_uncertainty_mm_per_h: Annotated[
        Vector | None, Field(description="Of `rate_mm_per_h`, from the scatter about the line, mm/h.")
    ]
    blocks: Annotated[list[DriftBlock], Field(description="Consecutive cycles, the first block first.")]


class Drift(ResponseModel):
    """Drift over the cycles and over time, for poses with at least two blocks of ten numbered cycles."""

    against: Annotated[
        DriftBasis,
        Field(
            description="`time`: times are known, and `rate_mm_per_h` is stated by them. `cycle`: drift is known from "
            "block to block of cycles alone."
        ),
    ]
    time_source: Annotated[
        TimeSource | None,
        Field(
            description="`captured_at`: times as stated with all images; `received_at`: when the images came, where "
            "some state no time; null for another instrument."
        ),
    ]
    poses: Annotated[list[PoseDrift], Field(description="Poses with two blocks or more, in natural order.")]


class PoseDistance(ResponseModel):
    """The way between two poses by ISO 9283:1998, 7.3: of the measured point, within each cycle that visits both."""

    from_pose_id: Annotated[str, Field(description="The pose at one end, by the user's tag.")]
    to_pose_id: Annotated[str, Field(description="The pose at the other end, by the user's tag.")]
    cycles: Annotated[int, Field(description="Cycles that visit both poses once.")]
    mean_mm: Annotated[float, Field(description="Mean over the cycles of the distance measured, mm.")]
    standard_uncertainty_mm: Annotated[
        float | None,
        Field(
            description="Of the mean, mm: its scatter over the cycles and, for images, what the shared lens and "
            "scale and shape of the print leave open; another instrument's common errors are not known. Null before "
            "a target whose pitch has no stated uncertainty."
        ),
    ]
    commanded_mm: Annotated[
        float | None,
        Field(
            description="The commanded distance, mm. Null where no positions were commanded, or other "
            "orientations at the two ends: then the "
            "measured point does not move as the commanded one."
        ),
    ]
    ad_mm: Annotated[
        float | None,
        Field(description="AD: attained less commanded, mm (7.3.2); null without `commanded_mm`."),
    ]
    ad_interval_mm: Annotated[
        Interval | None,
        Field(
            description="[low, high] of AD at the confidence level, mm: with what lens, scale and shape of the print "
            "leave open; of another instrument, of its scatter alone. Null before a target whose pitch has no stated "
            "uncertainty.",
            examples=[[-0.11, 0.14]],
        ),
    ]
    rd_mm: Annotated[float | None, Field(description="RD = 3 S of the distance, mm (7.3.3).")]
    interval_mm: Annotated[
        Interval | None, Field(description="[low, high] of RD at the confidence level, mm.")
    ]
    noise_floor_mm: Annotated[
        float | None,
        Field(description="The RD that the measurements' noise alone would give on a motionless robot, mm."),
    ]


class Approach(ResponseModel):
    """One direction from which a commanded pose was approached."""

    approach: Annotated[str, Field(description="The direction, as the commanded poses state it.")]
    pose_ids: Annotated[list[str], Field(description="The poses of this direction, by the user's tags.")]
    cycles: Annotated[int, Field(description="Visits from this direction.")]


class ApproachVariation(ResponseModel):
    """One commanded pose approached from several directions (ISO 9283:1998, 7.2.3)."""

    directions: Annotated[list[Approach], Field(description="The directions compared, two or more.")]
    variation: Annotated[
        VariationFigures,
        Field(
            description="vAP: the largest difference between the directions' mean poses: of the position its length, "
            "else the absolute difference on each axis and angle."
        ),
    ]
    expected_variation: Annotated[
        VariationFigures,
        Field(
            description="The expected reading if the direction made no difference, from the cycles' own scatter; null "
            "where no direction has two cycles."
        ),
    ]


class WitnessStep(ResponseModel):
    """Where a witness was in one cycle."""

    cycle: Annotated[int, Field(description="The cycle's number.")]
    motion_mm: Annotated[
        Vector, Field(description="Slow motion about its mean along x, y, z, in the frame of `mean`, mm.")
    ]
    motion_standard_uncertainty_mm: Annotated[
        float, Field(description="Standard uncertainty of `motion_mm` along an axis, mm.")
    ]


class WitnessRead(ResponseModel):
    """The slow motion of a pose that was revisited in every cycle: that of mount, target or room."""

    pose_id: PoseId
    moved: Annotated[bool, Field(description="Whether its visits show a motion beyond their scatter.")]
    subtracted: Annotated[
        bool, Field(description="Whether the motion is subtracted from the positions of all poses.")
    ]
    shift_mm: Annotated[Vector, Field(description="From its first cycle to its last along x, y, z, mm.")]
    shift_distance_mm: Annotated[float, Field(description="Length of `shift_mm`, mm.")]
    motion: Annotated[list[WitnessStep], Field(description="Cycle by cycle; zero where nothing moved.")]


class BurstRatio(ResponseModel):
    """Scatter of images within their stops against what the model of the noise says."""

    ratio_to_model: Annotated[float, Field(description="Standard deviation over the model's.")]
    p_value: Annotated[Share, Field(description="Chance of so large a scatter if the model were right.")]
    added: Annotated[
        bool,
        Field(
            description="Whether p is at most .01, and what images scatter beyond the model is added to it in floors, "
            "corrected figures and verdicts."
        ),
    ]


class BurstsRead(ResponseModel):
    """Several images of one stop, over all poses: what they scatter is the instrument's."""

    stop_count: Annotated[int, Field(description="Stops with two images or more.")]
    image_count: Annotated[int, Field(description="Their images.")]
    of_position: Annotated[BurstRatio, Field(description="Of positions.")]
    of_orientation: Annotated[BurstRatio, Field(description="Of orientations.")]


class PoseBurst(ResponseModel):
    """What the images within the stops of one pose scatter."""

    stop_count: Annotated[int, Field(description="Stops with two images or more; each counts as one cycle.")]
    image_count: Annotated[int, Field(description="Their images.")]
    degrees_of_freedom: Annotated[float, Field(description="Images less stops.")]
    noise_floor: Annotated[
        RepeatabilityFigures | None,
        Field(
            description="The reading that this scatter alone would give on a motionless robot, without any model of "
            "the noise; null below 5 degrees of freedom."
        ),
    ]
