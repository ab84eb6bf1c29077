"""The plan of poses to identify a robot's kinematics as JSON."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.analyses.dh.identification import (
    ConditionNumber,
    DhIdentifiable,
    DhUncertainty,
    JointNumber,
    NullSpace,
    ParallelToNext,
)
from app.api.schemas.analyses.dh.observability import ObservabilityIndicesRead
from app.api.schemas.camera import StatedCamera
from app.api.schemas.common import (
    MAX_JOINTS,
    MAX_LENGTH_MM,
    Identifier,
    JointAngles,
    RequestModel,
    ResponseModel,
)
from app.api.schemas.fields import JOINT_ANGLES, RobotId, TargetId

MAX_PLANNED_POSES = 2000
_Angle = Annotated[float, Field(gt=0.0, le=180.0)]
_Entry = Annotated[float, Field(ge=-MAX_LENGTH_MM, le=MAX_LENGTH_MM)]
_Row = Annotated[list[_Entry], Field(min_length=4, max_length=4)]


class PlannedCamera(StatedCamera):
    """The camera that will look: its lens, known or guessed, and the size of its images."""

    image_width_px: Annotated[int, Field(ge=16, le=65535, description="Columns of its images, px.")]
    image_height_px: Annotated[int, Field(ge=16, le=65535, description="Rows of its images, px.")]


class PlannedSweeps(RequestModel):
    """One sweep of every joint about home, or of those named."""

    sweep_half_angle_deg: Annotated[
        _Angle,
        Field(description="How far a sweep turns its joint of the chain either way from home, degrees."),
    ] = 40.0
    steps: Annotated[int, Field(ge=3, le=100, description="Poses of each sweep, at equal steps.")] = 11
    joint_numbers: Annotated[
        Annotated[
            list[Annotated[int, Field(ge=1, le=MAX_JOINTS)]], Field(min_length=1, max_length=MAX_JOINTS)
        ]
        | None,
        Field(description="The joints to sweep, from 1 at the base; null: all of them."),
    ] = None


class PoseToPlan(RequestModel):
    """A pose of the robot that is thought of."""

    joint_angles_deg: Annotated[JointAngles, Field(description="One angle a joint, degrees, from the base.")]


class DhPlanCreate(RequestModel):
    """Poses that are thought of, camera and grid; the grid is taken to stand straight before the camera at home."""

    target_id: Annotated[Identifier, Field(description="Id of the target that will be seen.")]
    camera: Annotated[PlannedCamera, Field(description="The camera on the flange; its lens is fitted, too.")]
    home_deg: Annotated[
        JointAngles,
        Field(
            description="Stated joint angles at which the camera looks squarely at the target, degrees, from the base."
        ),
    ]
    sweeps: Annotated[
        PlannedSweeps | None, Field(description="Sweeps of single joints about home; null: no sweeps.")
    ] = None
    random_poses: Annotated[
        int, Field(ge=0, le=1000, description="So many poses at random about home, all joints at once.")
    ] = 0
    poses: Annotated[list[PoseToPlan], Field(max_length=MAX_PLANNED_POSES)] = Field(
        default_factory=list, description="Further poses, listed one by one; 2,000 at most."
    )
    random_half_range_deg: Annotated[
        _Angle, Field(description="How far random poses and candidates lie from home, degrees.")
    ] = 30.0
    T_flange_camera: Annotated[
        Annotated[list[_Row], Field(min_length=4, max_length=4)] | None,
        Field(
            description="4 x 4, mm: maps points of the camera frame into that of the flange. Null: the frames "
            "coincide, "
            "and the camera looks along the flange's z."
        ),
    ] = None
    image_coverage: Annotated[
        float, Field(ge=0.05, le=1.0, description="What share of the image the grid fills at home.")
    ] = 0.5
    noise_px: Annotated[
        float, Field(ge=1e-4, le=10.0, description="Standard deviation of a grid point's coordinate, px.")
    ] = 0.05
    robot_position_sigma_mm: Annotated[
        float, Field(ge=0.0, le=100.0, description="The robot's own scatter of each coordinate, mm.")
    ] = 0.0
    robot_rotation_sigma_deg: Annotated[
        float, Field(ge=0.0, le=10.0, description="The robot's own scatter about each axis, degrees.")
    ] = 0.0
    suggest_count: Annotated[
        int, Field(ge=0, le=100, description="How many further poses to suggest, best first.")
    ] = 0
    candidate_count: Annotated[
        int, Field(ge=1, le=5000, description="Of how many random poses the suggested ones are chosen.")
    ] = 500


class PlannedPose(ResponseModel):
    """A pose, and whether the camera sees the whole grid at it; only then it counts."""

    joint_angles_deg: Annotated[list[float], Field(description=JOINT_ANGLES)]
    shows_target: Annotated[bool, Field(description="Whether the camera sees the whole grid.")]


class SuggestedPose(ResponseModel):
    """A further pose to take."""

    joint_angles_deg: Annotated[list[float], Field(description=JOINT_ANGLES)]


class PlannedJoint(ResponseModel):
    """Predicted uncertainties and identifiability of one joint."""

    joint: JointNumber
    parallel_to_next: ParallelToNext
    standard_uncertainty: Annotated[
        DhUncertainty, Field(description="Predicted for each parameter, in its unit.")
    ]
    identifiable: Annotated[
        DhIdentifiable, Field(description="Which parameters the planned poses would determine.")
    ]


class DhPlan(ResponseModel):
    """What the poses would determine, and the most informative further ones (by exchange on index O1)."""

    robot_id: RobotId
    target_id: TargetId
    poses: Annotated[
        list[PlannedPose], Field(description="All poses planned: sweeps, random ones, those listed.")
    ]
    joints: Annotated[list[PlannedJoint], Field(description="What the poses would determine, from the base.")]
    condition_number: ConditionNumber
    observability_o1: Annotated[
        float,
        Field(
            description="Borm and Menq's index: geometric mean of the singular values over the root of the number of "
            "poses; larger is better."
        ),
    ]
    observability_indices: Annotated[
        ObservabilityIndicesRead, Field(description="Five indices of the poses that count.")
    ]
    null_space: NullSpace
    suggested_poses: Annotated[list[SuggestedPose], Field(description="Further poses, best first.")]
    predicted_joints_with_suggestions: Annotated[
        list[PlannedJoint] | None,
        Field(description="As `joints`, with the suggested poses added; null without suggestions."),
    ]
    observability_indices_with_suggestions: Annotated[
        ObservabilityIndicesRead | None,
        Field(description="The indices with the suggested poses added; null without suggestions."),
    ]
