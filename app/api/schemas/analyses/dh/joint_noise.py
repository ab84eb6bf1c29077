"""Joint noise of a session's robot, and the repeatability that it predicts, as JSON."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.analyses.common import EstimatedAnalysis, Interval, Matrix, SourceField, Vector
from app.api.schemas.common import ResponseModel, Share
from app.api.schemas.fields import JOINT_ANGLES


class JointNoiseRead(ResponseModel):
    """How far one joint stops from where it is sent, at random; null where the poses do not move by it."""

    joint: Annotated[int, Field(description="From 1 at the base.")]
    sigma_deg: Annotated[float | None, Field(description="Standard deviation, degrees.")]
    interval_deg: Annotated[Interval | None, Field(description="[low, high] at 95 %, degrees.")]


class RemainingScatter(ResponseModel):
    """What the joints do not explain, the same in every direction."""

    position_sigma_mm: Annotated[float, Field(description="Standard deviation of each coordinate, mm.")]
    rotation_sigma_deg: Annotated[
        float | None,
        Field(description="Standard deviation about each axis, degrees; null for positions alone."),
    ]
    instrument_stated: Annotated[
        bool,
        Field(
            description="Whether the instrument's covariance was taken off; if not, its noise is part of this, and of "
            "what is predicted."
        ),
    ]


class ScatterValidation(ResponseModel):
    """Prediction and measurement at held-out poses, each predicted by the noise of the others."""

    scatter_ratio: Annotated[
        float,
        Field(description="Root mean square of the deviations over their prediction; 1 where it is right."),
    ]
    rp_log_rms: Annotated[
        float, Field(description="Root mean square of the logarithm of RP_l measured over RP_l predicted.")
    ]
    rp_log_expected: Annotated[float, Field(description="What the number of visits alone makes of it.")]
    constant_rp_log_rms: Annotated[
        float, Field(description="The same, of one covariance for all poses in place of the joints' noise.")
    ]
    log_likelihood_gain: Annotated[
        float,
        Field(
            description="Of the joints' noise over one covariance for all poses, free or equal in all directions, "
            "whichever predicts better."
        ),
    ]
    log_likelihood_gain_standard_error: Annotated[
        float, Field(description="Standard error of the gain, from the gains of the single poses.")
    ]
    supported: Annotated[bool, Field(description="Whether the gain is more than its standard error.")]


class Ellipsoid(ResponseModel):
    """Predicted scatter of the position: standard deviations along three axes at right angles, largest first."""

    sigma_mm: Annotated[Vector, Field(description="Standard deviations, mm.")]
    axes: Annotated[
        Matrix,
        Field(description="A row for each: its direction in the frame of the target or the instrument."),
    ]


class PredictedRepeatability(ResponseModel):
    """Predicted at joint angles, of the measured point: camera, probe or reflector."""

    joint_angles_deg: Annotated[list[float], Field(description=JOINT_ANGLES)]
    rp_l_mm: Annotated[float, Field(description="RP_l of ISO 9283 after endless cycles, mm.")]
    standard_uncertainty_mm: Annotated[float, Field(description="Its standard uncertainty, mm.")]
    interval_mm: Annotated[Interval, Field(description="[low, high] at 95 %, mm.")]
    ellipsoid: Annotated[Ellipsoid, Field(description="The scatter of the position.")]
    joint_share: Annotated[
        Share, Field(description="Share of the position's variance that the joints make, 0 to 1.")
    ]
    rotation_sigma_deg: Annotated[
        float | None,
        Field(description="Standard deviation of a rotation, degrees; null for positions alone."),
    ]


class PoseRepeatabilityPrediction(PredictedRepeatability):
    """A measured pose, and how it compares with what the other poses predict."""

    pose_id: Annotated[str, Field(description="The pose, by the user's tag.")]
    visits: Annotated[int, Field(description="Visits that count.")]
    rp_ratio: Annotated[
        float | None,
        Field(
            description="RP_l measured over RP_l that the other poses predict, both with the instrument's noise, the "
            "bias of few visits taken off; null where no visit counts."
        ),
    ]


class WorstPlace(PredictedRepeatability):
    """Where the predicted RP_l is largest in the workspace."""

    position_mm: Annotated[Vector, Field(description="The measured point in the robot's base frame, mm.")]


class RepeatabilityCellRead(ResponseModel):
    """One cell: RP_l of the configurations that bring the measured point there."""

    radius_mm: Annotated[float, Field(description="Distance of its middle from the first axis, mm.")]
    height_mm: Annotated[float, Field(description="Height of its middle along the first axis, mm.")]
    configurations: Annotated[int, Field(description="Configurations sampled in it.")]
    least_rp_l_mm: Annotated[float, Field(description="Smallest RP_l, mm.")]
    median_rp_l_mm: Annotated[float, Field(description="Median RP_l, mm.")]
    largest_rp_l_mm: Annotated[float, Field(description="Largest RP_l, mm.")]


class RepeatabilityMapRead(ResponseModel):
    """Predicted RP_l over the workspace, by distance from the first axis and height; the same all around."""

    cell_mm: Annotated[float, Field(description="Width and height of a cell, mm.")]
    samples: Annotated[int, Field(description="Configurations sampled over the whole workspace.")]
    repeatability_cells: Annotated[
        list[RepeatabilityCellRead], Field(description="Cells that three or more configurations reach.")
    ]


class JointNoiseAnalysis(EstimatedAnalysis):
    """Noise of the robot's joints by the scatter of repeated poses, and RP_l predicted anywhere (Brethé)."""

    source: SourceField
    joint_noise: Annotated[list[JointNoiseRead], Field(description="Each joint's, from the base.")]
    remaining_scatter: Annotated[RemainingScatter, Field(description="What the joints leave.")]
    scatter_validation: Annotated[ScatterValidation, Field(description="At held-out poses.")]
    poses: Annotated[
        list[PoseRepeatabilityPrediction], Field(description="The poses that were visited more than once.")
    ]
    predictions: Annotated[
        list[PredictedRepeatability], Field(description="At the joint angles of `at`, in their order.")
    ]
    worst_place: Annotated[WorstPlace, Field(description="Where predicted RP_l is largest.")]
    repeatability_map: Annotated[
        RepeatabilityMapRead, Field(description="Predicted RP_l over the workspace.")
    ]
    limits_stated: Annotated[
        list[bool],
        Field(
            description="Of each joint: whether the workspace ends at the robot's limits; if not, where the poses were."
        ),
    ]
