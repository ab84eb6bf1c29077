"""What a robot has beyond its chain, where its poses were, and how methods agree, as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import ResponseModel

DhMethod = TypeAliasType(
    "DhMethod",
    Annotated[
        Literal["cpa", "screw", "combined", "global"],
        Field(description="How Denavit-Hartenberg parameters are identified."),
    ],
)
DhModel = TypeAliasType(
    "DhModel",
    Annotated[
        Literal["auto", "dh", "extended"],
        Field(description="Which terms an identification has beyond Denavit-Hartenberg parameters."),
    ],
)
ErrorTerm = TypeAliasType(
    "ErrorTerm",
    Annotated[
        Literal["joint_curves", "compliance", "wobble", "approach"],
        Field(
            description="Curves of each joint over its own angle (gears, encoder); joints and links that give way to "
            "weight; axes that move as the joint turns; joints that stop elsewhere when they come from the other side "
            "(play, friction)."
        ),
    ],
)
JointAxis = TypeAliasType(
    "JointAxis",
    Annotated[
        Literal["x", "y", "z"],
        Field(description="An axis of the frame that a joint turns in; z is the joint's own."),
    ],
)
_JOINT = "The joint's number, from 1 at the base."


ErrorLevel = TypeAliasType(
    "ErrorLevel",
    Annotated[
        Literal["dh", "dh_and_compliance", "all"],
        Field(description="The chain alone; with compliance; with joint curves, compliance and wobble."),
    ],
)
_EVIDENCE = "in twice the logarithm of the marginal likelihood, over the chain alone."


class LevelRead(ResponseModel):
    """Which terms were taken, and why."""

    chosen: Annotated[ErrorLevel, Field(description="The level that was taken.")]
    configurations: Annotated[int, Field(description="Different joint configurations that it is fitted to.")]
    compliance_evidence: Annotated[float, Field(description=f"Of `dh_and_compliance`, {_EVIDENCE}")]
    all_evidence: Annotated[float, Field(description=f"Of `all`, {_EVIDENCE}")]
    held_out_ratio: Annotated[
        float | None,
        Field(
            description="The level's position error at poses held out at random, divided by that of the chain alone; "
            "null where poses are too few to hold any out."
        ),
    ]
    blocked_ratio: Annotated[
        float | None,
        Field(description="The same at clusters of joint space; null with fewer than 80 configurations."),
    ]
    reason: Annotated[str, Field(description="Why this level was taken, in words.")]
    gain: Annotated[str, Field(description="What it gains at held-out poses, in words.")]


class JointCurveRead(ResponseModel):
    """What a joint turns by beyond its stated angle, over the angles at which it was measured."""

    joint: Annotated[int, Field(description=_JOINT)]
    angles_deg: Annotated[list[float], Field(description="Stated angles, in steps of 2° or less, degrees.")]
    correction_deg: Annotated[
        list[float], Field(description="What the joint turns by beyond each of these, degrees.")
    ]
    standard_uncertainty_deg: Annotated[
        list[float], Field(description="Standard uncertainty of each correction, degrees.")
    ]


class ComplianceRead(ResponseModel):
    """How far a joint gives way to the weight of the arm beyond it."""

    joint: Annotated[int, Field(description=_JOINT)]
    axis: Annotated[JointAxis, Field(description="What the turn is about.")]
    rad_per_m: Annotated[
        float,
        Field(
            description="Turn per metre of lever: the moment about that axis of a unit weight at the centroid of the "
            "arm beyond the joint, rad/m, that does to the measured poses what the weights of all links together do. "
            "Divided by the weight beyond the joint in newtons it is rad/Nm. Part of it may be in the first "
            "harmonic of the joint's curve, which a link's own weight resembles: use both together."
        ),
    ]
    standard_uncertainty_rad_per_m: Annotated[float, Field(description="Its standard uncertainty, rad/m.")]


class ApproachRead(ResponseModel):
    """Where a joint stops by the side it comes from."""

    joint: Annotated[int, Field(description=_JOINT)]
    offset_deg: Annotated[
        float,
        Field(
            description="What the joint turns by beyond its stated angle when its last move was to a larger one, "
            "degrees; after a move to a smaller one it is the negative of this. Twice its size is the reversal error."
        ),
    ]
    offset_standard_uncertainty_deg: Annotated[float, Field(description="Its standard uncertainty, degrees.")]


class ErrorModelRead(ResponseModel):
    """Terms beyond the chain, fitted together with it under priors; their sizes are determined by the poses."""

    terms: Annotated[list[ErrorTerm], Field(description="The terms that the model has.")]
    joint_curves: Annotated[
        list[JointCurveRead], Field(description="One for each joint; empty without this term.")
    ]
    compliance: Annotated[
        list[ComplianceRead], Field(description="Those that the poses determine, joint by joint.")
    ]
    approach_offsets: Annotated[
        list[ApproachRead],
        Field(
            description="One for each joint of which the poses determine it; empty where the order in which they were "
            "measured is not known."
        ),
    ]
    noise_mm: Annotated[
        float, Field(description="What is left in each coordinate of position, standard deviation, mm.")
    ]
    noise_deg: Annotated[
        float | None,
        Field(description="What is left about each axis, degrees; null for positions alone."),
    ]
    held_out_ratio: Annotated[
        float | None,
        Field(
            description="Position error at poses held out at random, divided by that of the chain alone; null where "
            "poses are too few to hold any out."
        ),
    ]
    blocked_ratio: Annotated[
        float | None,
        Field(description="The same at clusters of joint space; null with fewer than 80 configurations."),
    ]
    position_uncertainty_factor: Annotated[
        float,
        Field(
            description="What stated uncertainties of predicted positions are multiplied by: rms of error over stated "
            "uncertainty at held-out clusters (or random folds), 1 at least."
        ),
    ]
    rotation_uncertainty_factor: Annotated[
        float | None, Field(description="The same of rotations; null for positions alone.")
    ]


class AngleGap(ResponseModel):
    """A gap of more than 10° between neighbouring angles of a joint."""

    minimum_deg: Annotated[float, Field(description="The largest angle below the gap, degrees.")]
    maximum_deg: Annotated[float, Field(description="The smallest angle above it, degrees.")]


class JointRegionRead(ResponseModel):
    """Where a joint was."""

    joint: Annotated[int, Field(description=_JOINT)]
    minimum_deg: Annotated[float, Field(description="Its smallest angle, degrees.")]
    maximum_deg: Annotated[float, Field(description="Its largest angle, degrees.")]
    gaps: Annotated[
        list[AngleGap], Field(description="Gaps over 10°: predictions inside them are less certain.")
    ]


class RegionRead(ResponseModel):
    """The region of validity."""

    joints: Annotated[list[JointRegionRead], Field(description="Each joint, from the base.")]


class MethodDifferenceRead(ResponseModel):
    """One method compared with `global`."""

    method: Annotated[DhMethod, Field(description="The method that is compared.")]
    largest_difference: Annotated[
        float | None,
        Field(
            description="Largest difference of a parameter that both identify, in stated uncertainties (root of the "
            "sum of both variances); null where the method or `global` has no answer."
        ),
    ]
    joint: Annotated[int | None, Field(description="The joint of that parameter, from 1; null likewise.")]
    parameter: Annotated[str | None, Field(description="That parameter, such as `a_mm`; null likewise.")]
    failure_code: Annotated[
        str | None, Field(description="The code of the reason where there is nothing to compare; else null.")
    ]


class MethodAgreementRead(ResponseModel):
    """Methods compared with `global`: the same poses, and models that differ."""

    largest_difference: Annotated[
        float | None,
        Field(
            description="The largest of all, in stated uncertainties; beyond 3 the warning `methods_disagree` is "
            "given. Null where either has no answer."
        ),
    ]
    methods: Annotated[
        list[MethodDifferenceRead],
        Field(description="With `global` each of the other methods, else the method that was asked for."),
    ]
