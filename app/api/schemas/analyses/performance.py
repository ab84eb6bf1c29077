"""Drift, distances and variation over approach directions by ISO 9283 as JSON."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.analyses.common import Interval, Vector
from app.api.schemas.analyses.figures import VariationFigures
from app.api.schemas.common import ResponseModel
from app.api.schemas.fields import PoseId


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
    shift_distance_mm: Annotated[float, Field(description="Length of `shift_mm`, mm.", examples=[0.043])]
    shift_deg: Annotated[
        Vector | None,
        Field(
            description="By which the mean orientation turned, as a rotation vector, degrees; null for positions alone."
        ),
    ]
    drp_mm: Annotated[
        float,
        Field(description="dRP_l: absolute difference of RP_l between the first block and the last, mm."),
    ]
    blocks: Annotated[list[DriftBlock], Field(description="Consecutive cycles, the first block first.")]


class Drift(ResponseModel):
    """Drift over the cycles, for poses with at least two blocks of ten numbered cycles."""

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
            "scale and shape of the print leave open; another instrument's common errors are not known."
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
            "leave open; of another instrument, of its scatter alone.",
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
