"""A robot's identified kinematics as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from app.api.schemas.analyses import AnalysisHead, Matrix, Source
from app.api.schemas.common import ResponseModel
from app.api.schemas.measurements import AdvisoryRead

DhMethod = Literal["cpa", "screw", "combined", "global"]
DhConvention = Literal["classic_dh"]


class DhUncertainty(ResponseModel):
    """Standard uncertainties; null where a parameter cannot be told."""

    a_mm: float | None
    alpha_deg: float | None
    d_mm: float | None
    theta_offset_deg: float | None
    beta_deg: float | None


class DhNominal(ResponseModel):
    """What the session's robot says of itself."""

    a_mm: float
    alpha_deg: float
    d_mm: float
    theta_offset_deg: float


class DhIdentifiable(ResponseModel):
    """Whether the poses tell a parameter."""

    a_mm: bool
    alpha_deg: bool
    d_mm: bool
    theta_offset_deg: bool
    beta_deg: bool


class PoseErrors(ResponseModel):
    """Root mean squares of distances and of rotation angles; the latter null for positions alone."""

    position_rms_mm: float
    rotation_rms_deg: float | None


class DhJoint(ResponseModel):
    """One joint and the link after it: T = Rz(θ + theta_offset) Tz(d) Tx(a) Rx(α), and Ry(β) where β stands for d."""

    joint: Annotated[int, Field(description="Counted from 1 at the base.")]
    a_mm: float
    alpha_deg: float
    d_mm: float
    theta_offset_deg: float
    beta_deg: Annotated[
        float | None,
        Field(
            description="Hayati's second turn, where this axis is near parallel to the next; d then stays at the "
            "nominal's value, or 0."
        ),
    ]
    parallel_to_next: bool
    standard_uncertainty: DhUncertainty
    nominal: DhNominal | None
    identifiable: Annotated[
        DhIdentifiable,
        Field(
            description="What is not identifiable has the nominal's value, or 0, and no uncertainty; `null_space` "
            "says in words with what it is confounded."
        ),
    ]
    arc_deg: Annotated[
        float, Field(description="The range of the joint's angle over the poses that tell of it.")
    ]
    poses: Annotated[
        int, Field(description="Poses that tell of it: of its sweeps, or all of them with method `global`.")
    ]
    residual: Annotated[
        PoseErrors | None,
        Field(description="At the poses where this joint alone moved; null where there are none."),
    ]


class DhValidation(PoseErrors):
    """Errors at poses that had no part in the fit: all are dealt into five folds, each predicted by the rest, with base
    and tool fitted to these.
    """

    held_out: Annotated[int, Field(description="How many poses were held out, over all folds.")]
    left_out: Annotated[
        int,
        Field(
            description="Poses that the fit of all of them has for gross errors, which nothing was asked to predict."
        ),
    ]
    nominal: Annotated[
        PoseErrors | None,
        Field(description="The nominal robot at the same poses, its tool and base fitted to the rest."),
    ]


class RobotScatter(ResponseModel):
    """What the robot adds to the instrument's own noise, per coordinate; all of the noise where none was stated."""

    position_mm: float
    rotation_deg: float | None


class DhTargetTransform(ResponseModel):
    """How two targets lie to one another, by images that show both or by way of the robot."""

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
    images: Annotated[int, Field(description="What it was found from: images, poses or pairs of axes.")]


class DhAnalysis(AnalysisHead):
    """A robot's Denavit-Hartenberg parameters, joint by joint, with what is and what is not known of them."""

    method: DhMethod
    source: Source
    convention: DhConvention
    joint_tolerance_deg: float
    sweeps: Annotated[
        list[str],
        Field(description="The sweeps that the request named; those of all other joints were recognised."),
    ]
    joints: list[DhJoint]
    residual: PoseErrors
    validation: DhValidation | None
    condition_number: Annotated[
        float | None,
        Field(
            description="Of the Jacobian by the parameters fitted, 1 mm and what moves the end by 1 mm alike."
        ),
    ]
    observability_o1: Annotated[
        float | None,
        Field(
            description="Borm and Menq's: geometric mean of the singular values over the root of the poses."
        ),
    ]
    null_space: Annotated[list[str], Field(description="What cannot be told from what, in sentences.")]
    parameters: Annotated[list[str], Field(description="What was fitted, in the order of `correlation`.")]
    correlation: Matrix
    robot_scatter: RobotScatter | None
    T_flange_camera: Annotated[
        Matrix | None,
        Field(description="4 x 4, mm: the camera, or the probe, on the last frame of the chain."),
    ]
    T_target_base: Annotated[
        list[Matrix],
        Field(
            description="4 x 4, mm, one for each target seen, in the session's order (one for another instrument): "
            "T_target_camera = T_target_base T_base_flange(q) T_flange_camera."
        ),
    ]
    target_transforms: list[DhTargetTransform]
    warnings: list[AdvisoryRead]
