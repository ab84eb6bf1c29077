"""The figures of ISO 9283 for one pose, and the decisions on a data sheet, as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.analyses.common import AcceptanceDecision, Interval, Vector
from app.api.schemas.common import ResponseModel

Tie = TypeAliasType(
    "Tie",
    Annotated[
        Literal["best_fit", "stated"],
        Field(
            description="`best_fit`: by least squares over the commanded poses; `stated`: by a given transform."
        ),
    ],
)


class RepeatabilityFigures(ResponseModel):
    """Pose repeatability by ISO 9283:1998, 7.2.2; null where it is not known."""

    rp_l_mm: Annotated[
        float | None,
        Field(
            description="Position: RP_l = mean distance from the mean position + 3 S of the distances, mm."
        ),
    ]
    rp_x_mm: Annotated[float | None, Field(description="3 S along the target frame's x, mm.")]
    rp_y_mm: Annotated[float | None, Field(description="3 S along the target frame's y, mm.")]
    rp_z_mm: Annotated[float | None, Field(description="3 S along the target frame's z, mm.")]
    rp_roll_deg: Annotated[float | None, Field(description="3 S of the roll angle, degrees.")]
    rp_pitch_deg: Annotated[float | None, Field(description="3 S of the pitch angle, degrees.")]
    rp_yaw_deg: Annotated[float | None, Field(description="3 S of the yaw angle, degrees.")]


class RepeatabilityIntervals(ResponseModel):
    """For each figure [low, high], between which it lies at the confidence level."""

    rp_l_mm: Annotated[
        Interval | None,
        Field(description="[low, high] of RP_l of the position, mm."),
    ]
    rp_x_mm: Annotated[
        Interval | None, Field(description="[low, high] of 3 S along the target frame's x, mm.")
    ]
    rp_y_mm: Annotated[
        Interval | None, Field(description="[low, high] of 3 S along the target frame's y, mm.")
    ]
    rp_z_mm: Annotated[
        Interval | None, Field(description="[low, high] of 3 S along the target frame's z, mm.")
    ]
    rp_roll_deg: Annotated[
        Interval | None, Field(description="[low, high] of 3 S of the roll angle, degrees.")
    ]
    rp_pitch_deg: Annotated[
        Interval | None, Field(description="[low, high] of 3 S of the pitch angle, degrees.")
    ]
    rp_yaw_deg: Annotated[Interval | None, Field(description="[low, high] of 3 S of the yaw angle, degrees.")]


class AccuracyFigures(ResponseModel):
    """Pose accuracy by ISO 9283:1998, 7.2.1; null where it is not known."""

    ap_p_mm: Annotated[
        float | None,
        Field(description="Position: distance of the attained mean from the commanded position, mm."),
    ]
    ap_x_mm: Annotated[
        float | None, Field(description="Attained less commanded along the base frame's x, mm.")
    ]
    ap_y_mm: Annotated[
        float | None, Field(description="Attained less commanded along the base frame's y, mm.")
    ]
    ap_z_mm: Annotated[
        float | None, Field(description="Attained less commanded along the base frame's z, mm.")
    ]
    ap_roll_deg: Annotated[float | None, Field(description="Attained less commanded roll angle, degrees.")]
    ap_pitch_deg: Annotated[float | None, Field(description="Attained less commanded pitch angle, degrees.")]
    ap_yaw_deg: Annotated[float | None, Field(description="Attained less commanded yaw angle, degrees.")]


class AccuracyIntervals(ResponseModel):
    """For each figure of accuracy [low, high], between which the robot's own deviation lies at the confidence level."""

    ap_p_mm: Annotated[Interval | None, Field(description="[low, high] of the distance AP, mm.")]
    ap_x_mm: Annotated[Interval | None, Field(description="[low, high] along the base frame's x, mm.")]
    ap_y_mm: Annotated[Interval | None, Field(description="[low, high] along the base frame's y, mm.")]
    ap_z_mm: Annotated[Interval | None, Field(description="[low, high] along the base frame's z, mm.")]
    ap_roll_deg: Annotated[Interval | None, Field(description="[low, high] of the roll angle, degrees.")]
    ap_pitch_deg: Annotated[Interval | None, Field(description="[low, high] of the pitch angle, degrees.")]
    ap_yaw_deg: Annotated[Interval | None, Field(description="[low, high] of the yaw angle, degrees.")]


class PoseAccuracy(AccuracyFigures):
    """AP of one pose in frames that the commanded poses tie.

    What moves all poses as one rigid body is not observable by such a tie.
    """

    ap_rotation_vector_deg: Annotated[
        Vector | None,
        Field(
            description="Attained less commanded orientation as a rotation vector in the base frame, degrees; it holds "
            "where pitch is near ±90° and the angles are null, too. Null where orientation is not compared.",
            examples=[[0.012, -0.007, 0.031]],
        ),
    ]
    interval: Annotated[
        AccuracyIntervals,
        Field(
            description="Of the figures, at the confidence level: what the tie, the scatter of the visits, the lens, "
            "and scale and shape of the print leave open. Null of positions before a target whose pitch has no "
            "stated uncertainty."
        ),
    ]
    held_out: Annotated[
        AccuracyFigures,
        Field(
            description="The same with the frames tied by all other poses; larger by what these leave open. Null "
            "where they do not suffice."
        ),
    ]
    degrees_of_freedom: Annotated[
        float, Field(description="Of the positions, beyond what the tie takes.", examples=[9.0])
    ]
    tie: Annotated[
        Tie,
        Field(description="How the robot's base and the measuring frame were tied.", examples=["best_fit"]),
    ]


class VariationFigures(ResponseModel):
    """Multi-directional pose accuracy variation by ISO 9283:1998, 7.2.3; null where it is not known."""

    vap_p_mm: Annotated[
        float | None,
        Field(description="Position: largest distance between two directions' mean positions, mm."),
    ]
    vap_x_mm: Annotated[
        float | None, Field(description="Largest difference of two directions' means along x, mm.")
    ]
    vap_y_mm: Annotated[
        float | None, Field(description="Largest difference of two directions' means along y, mm.")
    ]
    vap_z_mm: Annotated[
        float | None, Field(description="Largest difference of two directions' means along z, mm.")
    ]
    vap_roll_deg: Annotated[float | None, Field(description="Largest difference of the roll angle, degrees.")]
    vap_pitch_deg: Annotated[
        float | None, Field(description="Largest difference of the pitch angle, degrees.")
    ]
    vap_yaw_deg: Annotated[float | None, Field(description="Largest difference of the yaw angle, degrees.")]


class Acceptance(ResponseModel):
    """Whether the robot keeps a limit that its data sheet states: fields that both limits have."""

    pose_id: Annotated[
        str | None,
        Field(
            description="The pose that the decision rests on, or at which it is open; null: poses that cannot be "
            "judged leave it open, which `reason` names."
        ),
    ]
    decision: Annotated[
        AcceptanceDecision,
        Field(
            description="`pass`: the interval of every pose's figure lies within the limit, of RP_l of the corrected "
            "one, and by the pose's own cycles too, of AP_p also in the frames of the other poses; `fail`: that of one "
            "of m poses lies beyond it at the m-th part of the risk; `inconclusive` otherwise, and where a pose of the "
            "session has no ten cycles that count, are numbered and steady. AP_p is about the best fit of base and "
            "tool: an error that all poses share is not decided."
        ),
    ]
    rule: Annotated[str, Field(description="By which rule it is decided.")]
    reason: Annotated[str, Field(description="Why it is so decided.")]
    interval_mm: Annotated[
        Interval | None,
        Field(
            description="The 95 % interval at `pose_id`, which decides or leaves it open, mm. Of RP_l that of the "
            "corrected figure, from 0 where that has none and the upper limit as measured decides. Of AP_p the wider "
            "of the pose's interval and of that in the frames that the other poses tie. Null without `pose_id`."
        ),
    ]
    cycles_needed: Annotated[
        int | None,
        Field(
            description="How many cycles would decide if the reading stayed; null: decided, or no number up to 1,000 "
            "would. What the tie of the frames leaves open of AP_p no number of cycles narrows."
        ),
    ]
    poses_needed: Annotated[
        int | None,
        Field(
            description="Where cycles do not decide on AP_p: about how many commanded poses would in place of those of "
            "the session, if they deviated as these do; null: decided, cycles do, or no number up to 100 would, "
            "since the worst of more poses is worse."
        ),
    ]


class RepeatabilityAcceptance(Acceptance):
    """Whether the robot keeps the repeatability that its data sheet states."""

    datasheet_repeatability_mm: Annotated[float, Field(description="RP_l that the maker states, mm.")]
    worst_rp_l_mm: Annotated[
        float | None, Field(description="Largest RP_l of all poses as measured, mm; null: no pose has one.")
    ]


class AccuracyAcceptance(Acceptance):
    """Whether the robot keeps the accuracy that its data sheet states."""

    datasheet_accuracy_mm: Annotated[float, Field(description="AP_p that the maker states, mm.")]
    worst_ap_p_mm: Annotated[
        float | None, Field(description="Largest AP_p of all poses, mm; null: no pose has one.")
    ]
