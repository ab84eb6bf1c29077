"""Frames with their uncertainty as JSON: what hand-eye calibration and identification state of them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.analyses.common import Matrix, Vector
from app.api.schemas.common import ResponseModel
from app.api.schemas.fields import TargetId

_ROTATION_EXAMPLE = [[0.07, -0.99, 0.12], [0.99, 0.05, -0.1], [0.1, 0.13, 0.98]]
MATRIX_EXAMPLE = [
    [0.07, -0.99, 0.12, 60.0],
    [0.99, 0.05, -0.1, -25.0],
    [0.1, 0.13, 0.98, 90.0],
    [0, 0, 0, 1],
]
_COVARIANCE_EXAMPLE = [[0.01 if i == j < 3 else 1e-07 if i == j else 0.0 for j in range(6)] for i in range(6)]


class FrameUncertainty(ResponseModel):
    """Standard uncertainties (one standard deviation) of a frame's origin and angles; null where no pose determines one
    and it is held, so that the others are those given its value.
    """

    x_mm: Annotated[float | None, Field(description="Of the origin along x, mm.")]
    y_mm: Annotated[float | None, Field(description="Of the origin along y, mm.")]
    z_mm: Annotated[float | None, Field(description="Of the origin along z, mm.")]
    roll_deg: Annotated[float | None, Field(description="Of the roll angle, degrees.")]
    pitch_deg: Annotated[float | None, Field(description="Of the pitch angle, degrees.")]
    yaw_deg: Annotated[float | None, Field(description="Of the yaw angle, degrees.")]


class FrameRead(ResponseModel):
    """A frame with its uncertainty."""

    position_mm: Annotated[
        Vector, Field(description="The frame's origin x, y, z, mm.", examples=[[60.0, -25.0, 90.0]])
    ]
    rotation: Annotated[
        Matrix, Field(description="3 x 3 rotation matrix, rows first.", examples=[_ROTATION_EXAMPLE])
    ]
    roll_deg: Annotated[
        float, Field(description="Angle about x, degrees: R = Rz(yaw) Ry(pitch) Rx(roll).", examples=[7.55])
    ]
    pitch_deg: Annotated[
        float, Field(description="Angle about y, degrees, from -90 to 90.", examples=[-5.74])
    ]
    yaw_deg: Annotated[
        float, Field(description="Angle about z, degrees, from -180 to 180.", examples=[85.96])
    ]
    standard_uncertainty: Annotated[
        FrameUncertainty | None,
        Field(
            description="Standard uncertainties of origin (mm) and angles (degrees); null where the poses do not "
            "determine the frame, and with methods that state none."
        ),
    ]
    covariance: Annotated[
        Matrix | None,
        Field(
            description="6 x 6: x, y, z (mm), then a small rotation w (rad) with R_true = exp(w) R, in the frame that "
            "the transform leads to. Rows of what is held are zero. Null as `standard_uncertainty` is.",
            examples=[_COVARIANCE_EXAMPLE],
        ),
    ]


class FlangeCameraRead(FrameRead):
    """The camera on the flange."""

    T_flange_camera: Annotated[
        Matrix,
        Field(
            description="4 x 4, mm: maps points of the camera frame into that of the flange.",
            examples=[MATRIX_EXAMPLE],
        ),
    ]


class BaseCameraRead(FrameRead):
    """A fixed camera in the robot's base."""

    T_base_camera: Annotated[
        Matrix,
        Field(
            description="4 x 4, mm: maps points of the camera frame into the robot's base.",
            examples=[MATRIX_EXAMPLE],
        ),
    ]


class FlangeTargetRead(FrameRead):
    """The target on the flange, which a fixed camera looks at."""

    target_id: TargetId
    T_flange_target: Annotated[
        Matrix,
        Field(
            description="4 x 4, mm: maps points of the target into the frame of the flange.",
            examples=[MATRIX_EXAMPLE],
        ),
    ]


BaseCamera = Annotated[
    BaseCameraRead | None,
    Field(
        description="Of a session with `camera_mount` `fixed`: the camera in the robot's base, with its uncertainty; "
        "else null."
    ),
]
