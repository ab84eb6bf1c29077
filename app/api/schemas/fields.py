"""Keys that many bodies have, each with its one description: ids, poses, angles, matrices."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import Angle, Coordinate, JointAngles, PoseTag, Text

POSE_ID = "The user's own tag of the robot pose; unique within its session."
CYCLE = "Which of the repeated visits to the pose, from 1. Null: not known; such images are ordered by their SHA-256."
BURST = (
    "Which of several images of one stop of the robot, from 1: where an image has an index above 1, the images of its "
    "pose and cycle are one visit, whose scatter is the instrument's. An index above 1 needs a cycle."
)
FOCUS_GROUP = "The user's tag of one setting of the lens: images of one focus group share their intrinsics."
JOINT_ANGLES = (
    "Stated joint angles, degrees, in the order of the robot's joints from the base, signed as the "
    "encoders count."
)
ROLL = "Angle about x, degrees: R = Rz(yaw) Ry(pitch) Rx(roll)."
PITCH = "Angle about y, degrees: R = Rz(yaw) Ry(pitch) Rx(roll)."
YAW = "Angle about z, degrees: R = Rz(yaw) Ry(pitch) Rx(roll)."
_COMMANDED = "In the robot's base frame. Null: not commanded, or not known."

SessionId = Annotated[str, Field(description="Id of the session; opaque, made by the server.")]
TargetId = Annotated[str, Field(description="Id of the target; opaque, made by the server.")]
RobotId = Annotated[str, Field(description="Id of the robot; opaque, made by the server.")]
MeasurementId = Annotated[str, Field(description="Id of the image's measurement.")]
MeasurementOrNull = Annotated[
    str | None, Field(description="Id of the image's measurement; null of another instrument.")
]
MeasuredPoseOrNull = Annotated[
    str | None, Field(description="Id of what another instrument measured; null of an image.")
]
PoseId = Annotated[str, Field(description=POSE_ID)]
FocusGroup = Annotated[str, Field(description=FOCUS_GROUP)]
CoreVersion = Annotated[
    str,
    Field(
        description="Version and build of the numerics that computed the answer, such as `0.1.0+b3f2a91c04de`."
    ),
]

Estimator = TypeAliasType(
    "Estimator",
    Annotated[
        Literal[
            "pooled",
            "pooled_free_focal",
            "per_image",
            "per_image_session_prior",
            "per_image_fixed_pp",
            "given",
        ],
        Field(description="How the images of a session are combined."),
    ],
)
Source = TypeAliasType(
    "Source",
    Annotated[
        Literal["images", "measured_poses"], Field(description="Where an analysis has its poses from.")
    ],
)

PoseIdField = Annotated[PoseTag, Field(description=POSE_ID)]
StatedAngles = Annotated[JointAngles | None, Field(description=f"{JOINT_ANGLES} Null: not known.")]
StoredAngles = Annotated[list[float] | None, Field(description=f"{JOINT_ANGLES} Null: not known.")]

_POSITION = Field(
    description=f"Commanded position x, y, z of the flange, as the robot's controller states it, mm. {_COMMANDED}"
)
_ROLL = Field(description=f"{ROLL} {_COMMANDED}")
_PITCH = Field(description=f"{PITCH} {_COMMANDED}")
_YAW = Field(description=f"{YAW} {_COMMANDED}")
_APPROACH = Field(
    description="The direction from which the robot comes to the pose. Poses with equal commanded values and "
    "different `approach` give the variation by ISO 9283:1998, 7.2.3. Null: not stated."
)
CommandedPosition = Annotated[
    Annotated[list[Coordinate], Field(min_length=3, max_length=3)] | None, _POSITION
]
CommandedRoll = Annotated[Angle | None, _ROLL]
CommandedPitch = Annotated[Angle | None, _PITCH]
CommandedYaw = Annotated[Angle | None, _YAW]
CommandedApproach = Annotated[Text | None, _APPROACH]
StoredPosition = Annotated[Annotated[list[float], Field(min_length=3, max_length=3)] | None, _POSITION]
StoredRoll = Annotated[float | None, _ROLL]
StoredPitch = Annotated[float | None, _PITCH]
StoredYaw = Annotated[float | None, _YAW]
StoredApproach = Annotated[str | None, _APPROACH]

Roll = Annotated[float, Field(description=ROLL)]
Pitch = Annotated[float, Field(description=PITCH)]
Yaw = Annotated[float, Field(description=YAW)]
RotationMatrix = Annotated[
    list[list[float]],
    Field(description="3 x 3 rotation matrix, rows first; its columns are the pose's axes."),
]
PoseCovariance = Annotated[
    list[list[float]],
    Field(
        description="6 x 6 covariance: x, y, z (mm), then a small rotation w (rad) with R_true = exp(w) R_estimated, "
        "all along the axes of the frame that the pose is given in."
    ),
]
