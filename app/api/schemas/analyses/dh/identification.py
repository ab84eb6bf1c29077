"""A robot's identified kinematics as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from app.api.schemas.analyses.common import (
    EstimatedAnalysis,
    Matrix,
    SourceField,
    TargetTransform,
)
from app.api.schemas.analyses.dh.error_model import (
    DhMethod,
    DhModel,
    ErrorModelRead,
    LevelRead,
    MethodAgreementRead,
    RegionRead,
)
from app.api.schemas.analyses.dh.observability import ObservabilityIndicesRead, ParameterSamplingRead
from app.api.schemas.analyses.dh.validation import DhValidation, PoseErrors
from app.api.schemas.analyses.frames import BaseCamera, FlangeCameraRead, FlangeTargetRead, FrameRead
from app.api.schemas.common import ResponseModel

DhConvention = Literal["classic_dh"]
_A = "Link length: from this joint's axis to the next along their common normal, mm."
_ALPHA = "Link twist: from this joint's axis to the next about the common normal, degrees."
_D = "Joint offset along this joint's axis, mm."
_THETA = "What is added to the stated joint angle about this joint's axis, degrees."
JointNumber = Annotated[int, Field(description="The joint's number, from 1 at the base.")]
ParallelToNext = Annotated[
    bool,
    Field(
        description="Whether this axis is so near to parallel to the next one that d is not determined, or the "
        "session's robot states a `beta_deg`: this is used, and d kept."
    ),
]
ConditionNumber = Annotated[
    float | None,
    Field(
        description="Of the Jacobian with respect to the fitted parameters; an angle is scaled so that one unit "
        "moves the "
        "end by 1 mm. Above 100 some parameters are determined far less accurately than others. Null: not finite."
    ),
]


class UnidentifiableRead(ResponseModel):
    """Parameters that the poses do not determine separately."""

    parameters: Annotated[
        list[str],
        Field(
            description="Their keys, as `DhAnalysis.parameters` has them: `joint_2.d_mm`, `flange_camera.x_mm`. "
            "`flange_camera` or `target_base` alone: the whole transform."
        ),
    ]
    sentence: Annotated[str, Field(description="The same in words, with the reason where it is known.")]


NullSpace = Annotated[
    list[UnidentifiableRead],
    Field(
        description="Combinations of parameters that the poses do not determine. Those of joints keep the nominal "
        "robot's values, zero without one. Where all axes are parallel, the flange is level with the measured point."
    ),
]


class DhUncertainty(ResponseModel):
    """Standard uncertainties; null where a parameter is not identifiable."""

    a_mm: Annotated[float | None, Field(description="Standard uncertainty of `a_mm`, mm.")]
    alpha_deg: Annotated[float | None, Field(description="Standard uncertainty of `alpha_deg`, degrees.")]
    d_mm: Annotated[float | None, Field(description="Standard uncertainty of `d_mm`, mm.")]
    theta_offset_deg: Annotated[
        float | None, Field(description="Standard uncertainty of `theta_offset_deg`, degrees.")
    ]
    beta_deg: Annotated[
        float | None,
        Field(description="Standard uncertainty of `beta_deg`, degrees; null where β is not used."),
    ]


class DhNominal(ResponseModel):
    """What the session's robot says of itself."""

    a_mm: Annotated[float, Field(description=_A)]
    alpha_deg: Annotated[float, Field(description=_ALPHA)]
    d_mm: Annotated[float, Field(description=_D)]
    theta_offset_deg: Annotated[float, Field(description=_THETA)]
    beta_deg: Annotated[
        float | None,
        Field(description="Hayati's second turn about y, degrees; null where the robot states none."),
    ]


class DhIdentifiable(ResponseModel):
    """Whether the poses determine a parameter."""

    a_mm: Annotated[bool, Field(description="Whether the poses determine `a_mm`.")]
    alpha_deg: Annotated[bool, Field(description="Whether the poses determine `alpha_deg`.")]
    d_mm: Annotated[bool, Field(description="Whether the poses determine `d_mm`; false where β is used.")]
    theta_offset_deg: Annotated[bool, Field(description="Whether the poses determine `theta_offset_deg`.")]
    beta_deg: Annotated[
        bool, Field(description="Whether the poses determine `beta_deg`; false where it is not used.")
    ]


class DhJoint(ResponseModel):
    """One joint and the link after it: T = Rz(θ + theta_offset) Tz(d) Tx(a) Rx(α), and Ry(β) where β stands for d."""

    joint: JointNumber
    a_mm: Annotated[float, Field(description=_A)]
    alpha_deg: Annotated[float, Field(description=_ALPHA)]
    d_mm: Annotated[float, Field(description=_D)]
    theta_offset_deg: Annotated[float, Field(description=_THETA)]
    beta_deg: Annotated[
        float | None,
        Field(
            description="Hayati's second turn about y, degrees, where this axis is near parallel to the next; d then "
            "stays at the nominal's value, or 0. Null where it is not used."
        ),
    ]
    parallel_to_next: ParallelToNext
    standard_uncertainty: Annotated[DhUncertainty, Field(description="Of each parameter, in its unit.")]
    nominal: Annotated[
        DhNominal | None,
        Field(description="The same joint of the session's robot; null for a session without `robot_id`."),
    ]
    identifiable: Annotated[
        DhIdentifiable,
        Field(
            description="What is not identifiable has the nominal's value, or 0, and no uncertainty; `null_space` "
            "says in words with what it is confounded."
        ),
    ]
    arc_deg: Annotated[
        float, Field(description="The range of the joint's angle over the poses that observe it, degrees.")
    ]
    poses: Annotated[
        int,
        Field(description="Poses that observe it: those of its sweeps, or all of them with method `global`."),
    ]
    residual: Annotated[
        PoseErrors | None,
        Field(description="At the poses where this joint alone moved; null without such poses."),
    ]


class RobotScatter(ResponseModel):
    """What the robot adds to the instrument's own noise, per coordinate; all of the noise where none was stated."""

    position_sigma_mm: Annotated[float, Field(description="Standard deviation of each coordinate, mm.")]
    rotation_sigma_deg: Annotated[
        float | None,
        Field(description="Standard deviation about each axis, degrees; null for positions alone."),
    ]


class TargetInBase(FrameRead):
    """Where a target lies in the robot's base frame."""

    target_id: Annotated[str | None, Field(description="The target; null for another instrument's frame.")]
    T_base_target: Annotated[
        Matrix,
        Field(
            description="4 x 4, mm: maps points of the target frame into the base frame; T_base_target "
            "T_target_camera = T_base_flange(q) T_flange_camera."
        ),
    ]


class DhAnalysis(EstimatedAnalysis):
    """A robot's Denavit-Hartenberg parameters, joint by joint, with what is and what is not known of them."""

    method: Annotated[
        DhMethod, Field(description="The method asked for; the query parameter describes each.")
    ]
    model: Annotated[
        DhModel, Field(description="The model asked for; `error_model` says which terms were taken.")
    ]
    source: SourceField
    convention: Annotated[
        DhConvention, Field(description="Classic (distal) Denavit-Hartenberg: Rz(θ) Tz(d) Tx(a) Rx(α).")
    ]
    joint_coupling: Annotated[
        list[list[float]] | None,
        Field(
            description="The robot's: the chain's joint angles are this matrix times the stated ones; null: they are "
            "the stated ones."
        ),
    ]
    joint_tolerance_deg: Annotated[
        float,
        Field(
            description="Within a sweep of a joint the other joints' stated angles agree to this, degrees."
        ),
    ]
    named_sweeps: Annotated[
        list[str],
        Field(description="The sweeps that the request named; those of all other joints were recognised."),
    ]
    joints: Annotated[list[DhJoint], Field(description="The robot's joints, from the base.")]
    residual: Annotated[PoseErrors, Field(description="Of the poses that the fit used.")]
    chain_residual: Annotated[
        PoseErrors | None,
        Field(
            description="Of the same poses about the chain without the terms of `error_model`, base and tool fitted to "
            "it; the best chain by itself is another one, that of `model=dh`, which files of a chain hold. Null "
            "without terms."
        ),
    ]
    validation: Annotated[
        DhValidation | None,
        Field(description="Five-fold cross-validation; null where the folds leave too few poses of an arc."),
    ]
    level: Annotated[
        LevelRead | None,
        Field(
            description="The level of `error_model`, and the evidence for it. Null with the methods that begin at "
            "axes, and where the levels were not compared."
        ),
    ]
    error_model: Annotated[
        ErrorModelRead | None,
        Field(
            description="What the robot has beyond its chain. Null where the poses do not speak for such terms, with "
            "`model=dh`, and with the methods that begin at axes."
        ),
    ]
    region: Annotated[
        RegionRead, Field(description="Where the poses were: what is stated holds there, and not beyond.")
    ]
    method_agreement: Annotated[
        MethodAgreementRead | None,
        Field(
            description="Methods compared with `global`: with `global` all others, null where a joint has no sweep; "
            "with another method that one."
        ),
    ]
    condition_number: ConditionNumber
    observability_o1: Annotated[
        float | None,
        Field(
            description="Borm and Menq's: geometric mean of the singular values over the root of the number of poses; "
            "compares sets of poses of one robot, and larger is better."
        ),
    ]
    observability_indices: Annotated[
        ObservabilityIndicesRead, Field(description="Five indices of the poses used.")
    ]
    null_space: NullSpace
    parameters: Annotated[
        list[str],
        Field(
            description="What was fitted, in the order of `correlation`: `joint_2.a_mm`, `flange_camera.x_mm`, "
            "`target_base.rotation_z_deg` (T_target_base, its rotation from the left; `target_base_2` of the second "
            "target); of a fixed camera `flange_target` and `camera_base`."
        ),
    ]
    correlation: Annotated[
        Matrix,
        Field(description="Correlations of the fitted parameters, -1 to 1, in the order of `parameters`."),
    ]
    parameter_sampling: Annotated[
        ParameterSamplingRead | None,
        Field(description="The parameters by sampling; null unless `uncertainty=monte_carlo`."),
    ]
    robot_scatter: Annotated[
        RobotScatter, Field(description="The robot's own deviations, estimated from the residuals.")
    ]
    flange_camera: Annotated[
        FlangeCameraRead | None,
        Field(
            description="The camera, or the probe, on the last frame of the chain; null where a fixed camera measured "
            "the poses."
        ),
    ]
    base_targets: Annotated[
        list[TargetInBase],
        Field(
            description="Each target seen, in the session's order; for another instrument, its frame. Empty where a "
            "fixed camera measured the poses."
        ),
    ]
    base_camera: BaseCamera
    flange_targets: Annotated[
        list[FlangeTargetRead],
        Field(description="The target on the last frame of the chain that a fixed camera saw; else empty."),
    ]
    target_transforms: Annotated[
        list[TargetTransform],
        Field(description="How the targets lie to one another; empty with one target or another instrument."),
    ]
