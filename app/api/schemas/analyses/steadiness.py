"""Whether the cycles of a session are independent and identically distributed as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.analyses.common import Vector
from app.api.schemas.common import ResponseModel, Share
from app.api.schemas.fields import PoseId

Attribution = TypeAliasType(
    "Attribution",
    Annotated[
        Literal["common", "pose_by_pose", "undetermined"],
        Field(
            description="What a motion belongs to: all poses together (mount, camera, target, temperature), poses by "
            "themselves (robot), or not determined."
        ),
    ],
)


CountedIn = TypeAliasType(
    "CountedIn",
    Annotated[
        Literal["cycles", "visits"],
        Field(
            description="`cycles`: by their stated numbers. `visits`: each pose's own, where poses have less than half "
            "of the numbers in common."
        ),
    ],
)


class SteadinessPValues(ResponseModel):
    """Probability of statistics as extreme as these for steady cycles, by permuting the cycles."""

    overall_p_value: Annotated[
        Share, Field(description="Of the most extreme of all nine statistics; `not_steady` at .01 or less.")
    ]
    trend_p_value: Annotated[Share, Field(description="Of a straight line over the cycles.")]
    change_point_p_value: Annotated[Share, Field(description="Of a step between two cycles.")]
    autocorrelation_p_value: Annotated[
        Share,
        Field(
            description="Of the product of successive cycles; at .02 or less, intervals allow for correlation."
        ),
    ]
    permutations: Annotated[
        int, Field(description="Permutations of the cycles; no p is below one over their number and one.")
    ]


class CommonTrend(ResponseModel):
    """Change of the motion that all poses share, by a straight line over the cycles."""

    change_mm: Annotated[
        Vector,
        Field(description="From the first cycle to the last along x, y, z, mm, in the frame of `mean`."),
    ]
    change_standard_uncertainty_mm: Annotated[
        Vector,
        Field(
            description="Of `change_mm`, mm, if the cycles scatter independently about the line.",
            examples=[[0.004, 0.005, 0.009]],
        ),
    ]
    change_distance_mm: Annotated[float, Field(description="Length of `change_mm`, mm.")]


class CommonStep(ResponseModel):
    """The largest step of the poses between two cycles."""

    cycle: Annotated[int, Field(description="The first cycle after the step, or visit by `counted_in`.")]
    step_mm: Annotated[
        Vector,
        Field(
            description="Mean of the motion that all poses share from that cycle on less that before, x, y, z, mm."
        ),
    ]
    step_standard_uncertainty_mm: Annotated[
        Vector,
        Field(
            description="Of `step_mm`, mm, if the cycles scatter independently on both sides.",
            examples=[[0.003, 0.004, 0.006]],
        ),
    ]
    step_distance_mm: Annotated[float, Field(description="Length of `step_mm`, mm.")]


class CommonMotion(ResponseModel):
    """What the motion belongs to."""

    attribution: Annotated[Attribution, Field(description="All poses together, or poses by themselves.")]
    share: Annotated[
        float | None,
        Field(
            description="Share of the poses' slow motion that is common to all: near 1 for mount, camera or target, "
            "near one over the number of poses for poses that move by themselves; null below 20 cycles and two poses."
        ),
    ]


class PoseSteadiness(ResponseModel):
    """One pose of the test."""

    pose_id: PoseId
    steady: Annotated[bool, Field(description="False where its verdict is `not_steady`.")]
    p_value: Annotated[
        Share, Field(description="Of its own three statistics, adjusted for the number of poses.")
    ]
    change_mm: Annotated[
        Vector,
        Field(description="Its change from the first cycle to the last by a straight line, x, y, z, mm."),
    ]
    change_distance_mm: Annotated[float, Field(description="Length of `change_mm`, mm.")]
    step_mm: Annotated[
        Vector | None,
        Field(description="Its own step at the session's `change_point`, x, y, z, mm; null without one."),
    ]
    change_cycle: Annotated[
        int | None,
        Field(description="The first cycle after its own largest step; null for fewer than four visits."),
    ]


class TwoStoppingPoints(ResponseModel):
    """A pose whose cycles form two clusters."""

    pose_id: PoseId
    distance_mm: Annotated[float, Field(description="Between the clusters' means, mm.", examples=[0.24])]
    within_share: Annotated[
        Share,
        Field(
            description="Sum of squares within both clusters over that of all cycles, along their main axis.",
            examples=[0.05],
        ),
    ]
    measurement_ids: Annotated[
        list[str],
        Field(description="Images of the smaller cluster; of a burst the first."),
    ]
    measured_pose_ids: Annotated[
        list[str], Field(description="What another instrument measured of the smaller cluster.")
    ]


class Steadiness(ResponseModel):
    """Whether cycles are independent and identically distributed, by all poses jointly; decides `not_steady`."""

    steady: Annotated[
        bool | None,
        Field(
            description="False with an overall p of .01 or less, or two stopping points; null: not tested."
        ),
    ]
    cycles: Annotated[
        int, Field(description="Cycles in the test, over all poses; 0 without numbered cycles.")
    ]
    counted_in: Annotated[CountedIn, Field(description="What the test counts by.")]
    p_values: Annotated[
        SteadinessPValues | None,
        Field(description="Null where no pose has six visits with a cycle number, and nothing is tested."),
    ]
    trend: Annotated[
        CommonTrend | None, Field(description="Of the motion that all poses share; null where not tested.")
    ]
    change_point: Annotated[
        CommonStep | None,
        Field(description="The most likely step, significant or not; null where not tested."),
    ]
    autocorrelation: Annotated[
        float | None,
        Field(
            description="Correlation of successive cycles, mean of its posterior; 0 where it is not significant; null "
            "where not tested."
        ),
    ]
    effective_cycles: Annotated[
        float | None,
        Field(
            description="How many independent cycles determine the scatter as well as those of the pose that has most; "
            "null where not tested."
        ),
    ]
    heavy_tails_probability: Annotated[
        Share,
        Field(
            description="Probability that cycles have heavier tails than Gaussian ones; intervals allow for them by it."
        ),
    ]
    common_motion: Annotated[
        CommonMotion | None, Field(description="What moved; null where the cycles' order has no effect.")
    ]
    poses: Annotated[
        list[PoseSteadiness], Field(description="Poses of the test in natural order; empty where not tested.")
    ]
    two_points: Annotated[
        list[TwoStoppingPoints], Field(description="Poses with two stopping points; from ten cycles on.")
    ]
