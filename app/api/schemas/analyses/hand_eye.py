"""Hand-eye calibration as JSON."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.analyses.common import EstimatedAnalysis, Matrix, Vector
from app.api.schemas.analyses.dh.validation import PoseErrors
from app.api.schemas.analyses.frames import (
    MATRIX_EXAMPLE,
    BaseCamera,
    FlangeCameraRead,
    FlangeTargetRead,
    FrameRead,
)
from app.api.schemas.common import ResponseModel
from app.api.schemas.fields import POSE_ID, TargetId

_PoseCount = Annotated[
    int, Field(description="How many poses show this target, rejected ones too.", examples=[12])
]


class BaseTargetRead(FrameRead):
    """A target in the robot's base."""

    target_id: TargetId
    pose_count: _PoseCount
    T_base_target: Annotated[
        Matrix,
        Field(
            description="4 x 4, mm: maps points of the target into the robot's base.",
            examples=[MATRIX_EXAMPLE],
        ),
    ]


class MountedTargetRead(FlangeTargetRead):
    """The target on the flange, with how many poses show it."""

    pose_count: _PoseCount


class DeviationRead(ResponseModel):
    """Attained - commanded, in the robot's base."""

    position_mm: Annotated[Vector, Field(description="x, y, z, mm.", examples=[[0.12, -0.31, 0.08]])]
    rotation_deg: Annotated[
        Vector,
        Field(description="Rotation vector: axis times angle, degrees.", examples=[[0.01, -0.02, 0.004]]),
    ]
    distance_mm: Annotated[
        float, Field(description="Length of the position's deviation, mm.", examples=[0.342])
    ]
    angle_deg: Annotated[
        float, Field(description="Angle of the rotation's deviation, degrees.", examples=[0.0227])
    ]


class HandEyeResidualRead(ResponseModel):
    """One commanded pose before one target, the mean of its images."""

    pose_id: Annotated[str, Field(description=POSE_ID, examples=["P1"])]
    target_id: TargetId
    image_count: Annotated[int, Field(description="How many images of the pose are averaged.", examples=[3])]
    used: Annotated[
        bool,
        Field(
            description="False where the pose is rejected: far from where the others say it is.",
            examples=[True],
        ),
    ]
    fitted_deviation: Annotated[
        DeviationRead, Field(description="With the frames as they are; the fit follows each pose a little.")
    ]
    held_out_deviation: Annotated[
        DeviationRead | None,
        Field(description="With the frames from all other poses; null where these do not suffice."),
    ]


class HandEyeValidationRead(PoseErrors):
    """Errors of poses that the frames from all other poses predict."""

    pose_count: Annotated[int, Field(description="How many poses were predicted.", examples=[12])]


class ExcludedPoseRead(ResponseModel):
    """A pose that does not count."""

    pose_id: Annotated[str, Field(description=POSE_ID, examples=["P7"])]
    code: Annotated[
        str,
        Field(
            description="`commanded_pose_missing` or `no_usable_images`.", examples=["commanded_pose_missing"]
        ),
    ]
    detail: Annotated[
        str,
        Field(
            description="The reason in a sentence, for people.",
            examples=["Its commanded pose is not known whole."],
        ),
    ]


class DistanceScale(ResponseModel):
    """By how much commanded distances are longer than the images show them: a print of another pitch than stated, or a
    robot of other lengths than its own.
    """

    difference: Annotated[
        float,
        Field(
            description="Commanded distances over measured ones, less 1; 0.03: 3 % longer. It is not in the frames.",
            examples=[0.0002],
        ),
    ]
    difference_standard_uncertainty: Annotated[
        float,
        Field(description="That of `difference`, with the lens and a stated pitch's.", examples=[0.0003]),
    ]


class HandEyeAnalysis(EstimatedAnalysis):
    """Where the camera sits on the flange and the targets lie in the base: T_base_flange = T_base_target
    T_target_camera T_camera_flange at every pose, but for the robot's deviation. Of a fixed camera, where it is in
    the base and the target on the flange: T_base_flange = T_base_camera T_camera_target T_target_flange.
    """

    flange_camera: Annotated[
        FlangeCameraRead | None,
        Field(
            description="The camera in the flange's frame, with its uncertainty; null of a session with `camera_mount` "
            "`fixed`."
        ),
    ]
    base_targets: Annotated[
        list[BaseTargetRead],
        Field(description="One for each target that was seen; empty with a fixed camera."),
    ]
    base_camera: BaseCamera
    flange_targets: Annotated[
        list[MountedTargetRead],
        Field(
            description="The target on the flange that a fixed camera saw; empty with a camera on the robot."
        ),
    ]
    coverage_factor: Annotated[
        float,
        Field(
            description="A 95 % interval is the value ± this times the standard uncertainty (Student's t: the robot's "
            "deviations are estimated from few poses).",
            examples=[2.04],
        ),
    ]
    robot_scatter_mm: Annotated[
        float,
        Field(
            description="Standard deviation of the commanded poses' errors along each axis, beyond what the images "
            "explain, mm.",
            examples=[0.3],
        ),
    ]
    robot_scatter_deg: Annotated[
        float, Field(description="The same of the rotation about each axis, degrees.", examples=[0.03])
    ]
    distance_scale: Annotated[
        DistanceScale | None,
        Field(
            description="Commanded distances against measured ones; null where the poses do not determine it."
        ),
    ]
    residuals: Annotated[list[HandEyeResidualRead], Field(description="Pose by pose, P2 before P10.")]
    residual: Annotated[PoseErrors, Field(description="Of the fitted deviations of the poses used.")]
    validation: Annotated[
        HandEyeValidationRead | None,
        Field(description="Of the held-out deviations of the poses used; null where poses are too few."),
    ]
    excluded_poses: Annotated[list[ExcludedPoseRead], Field(description="Poses that do not count, and why.")]
