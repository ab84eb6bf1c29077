"""What is asked before a robot moves, and what is predicted, as JSON."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.common import (
    MAX_JOINTS,
    MAX_LENGTH_MM,
    Identifier,
    JointAngles,
    RequestModel,
    ResponseModel,
)
from app.api.schemas.kinematics import DhIdentifiable, DhUncertainty
from app.api.schemas.resources import DistortionCoefficient, FocalLength, PixelCoordinate

MAX_PLANNED_POSES = 2000

_Angle = Annotated[float, Field(gt=0.0, le=180.0)]
_Entry = Annotated[float, Field(ge=-MAX_LENGTH_MM, le=MAX_LENGTH_MM)]
_Row = Annotated[list[_Entry], Field(min_length=4, max_length=4)]


class PlannedCamera(RequestModel):
    """The camera that will look: its lens, known or guessed, and the size of its images."""

    fx_px: FocalLength
    fy_px: FocalLength
    cx_px: PixelCoordinate
    cy_px: PixelCoordinate
    k1: DistortionCoefficient = 0.0
    k2: DistortionCoefficient = 0.0
    p1: DistortionCoefficient = 0.0
    p2: DistortionCoefficient = 0.0
    k3: DistortionCoefficient = 0.0
    image_width_px: Annotated[int, Field(ge=16, le=65535)]
    image_height_px: Annotated[int, Field(ge=16, le=65535)]


class PlannedSweeps(RequestModel):
    """One sweep of every joint about home, or of those named."""

    half_arc_deg: _Angle = 40.0
    steps: Annotated[int, Field(ge=3, le=100)] = 11
    joints: (
        Annotated[
            list[Annotated[int, Field(ge=1, le=MAX_JOINTS)]], Field(min_length=1, max_length=MAX_JOINTS)
        ]
        | None
    ) = None


class DhPlanCreate(RequestModel):
    """Poses that are thought of, camera and grid; the grid is taken to stand straight before the camera at home."""

    target_id: Identifier
    camera: PlannedCamera
    home_deg: JointAngles
    sweeps: PlannedSweeps | None = None
    free_poses: Annotated[
        int, Field(ge=0, le=1000, description="So many poses at random about home, all joints at once.")
    ] = 0
    joint_angles_deg: Annotated[list[JointAngles], Field(max_length=MAX_PLANNED_POSES)] = Field(
        default_factory=list, description="Further poses, one by one."
    )
    half_range_deg: Annotated[
        _Angle, Field(description="How far free poses and candidates lie from home.")
    ] = 30.0
    T_flange_camera: (
        Annotated[
            list[_Row],
            Field(
                min_length=4,
                max_length=4,
                description="4 x 4, mm; null: the camera looks along the flange's z.",
            ),
        ]
        | None
    ) = None
    fill: Annotated[
        float, Field(ge=0.05, le=1.0, description="What share of the image the grid fills at home.")
    ] = 0.5
    noise_px: Annotated[
        float, Field(ge=1e-4, le=10.0, description="Standard deviation of a grid point's coordinate.")
    ] = 0.05
    robot_position_mm: Annotated[
        float, Field(ge=0.0, le=100.0, description="The robot's own scatter of each coordinate.")
    ] = 0.0
    robot_rotation_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    suggest: Annotated[
        int, Field(ge=0, le=100, description="How many further poses to suggest, best first.")
    ] = 0
    candidates: Annotated[
        int, Field(ge=1, le=5000, description="Of how many random poses the suggested ones are chosen.")
    ] = 500


class PlannedPose(ResponseModel):
    """A pose, and whether the camera sees the whole grid at it; only then it counts."""

    joint_angles_deg: list[float]
    visible: bool


class PlannedJoint(ResponseModel):
    """What the poses would tell of one joint."""

    joint: int
    parallel_to_next: bool
    standard_uncertainty: DhUncertainty
    identifiable: DhIdentifiable


class DhPlan(ResponseModel):
    """What the poses would tell, and which further ones would tell most (greedy on the observability index O1)."""

    robot_id: str
    target_id: str
    poses: list[PlannedPose]
    joints: list[PlannedJoint]
    condition_number: float | None
    observability_o1: float
    null_space: list[str]
    suggested: Annotated[list[list[float]], Field(description="Joint angles, degrees; best first.")]
    joints_with_suggested: Annotated[
        list[PlannedJoint] | None, Field(description="The same with the suggested poses added.")
    ]
