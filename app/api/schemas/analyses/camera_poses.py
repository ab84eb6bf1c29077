"""The camera's pose of every image as JSON."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.analyses.common import EstimatedAnalysis, Matrix
from app.api.schemas.camera import CameraPoseRead
from app.api.schemas.common import ResponseModel
from app.api.schemas.fields import CYCLE, FOCUS_GROUP, POSE_ID


class ReasonRead(ResponseModel):
    """Why an image does not count."""

    code: Annotated[
        str,
        Field(
            description="Stable name of the reason, in snake_case; docs/errors.md lists failures.",
            examples=["orientation_inconsistent"],
        ),
    ]
    detail: Annotated[
        str,
        Field(
            description="The reason in a sentence with its figures, for people.",
            examples=["The image has 640 x 480 px, its focus group 2448 x 2050."],
        ),
    ]


class OwnFocalRead(ResponseModel):
    """The focal length of an image's own camera."""

    focal_px: Annotated[float, Field(description="Mean of fx and fy, px.", examples=[1480.3])]
    standard_uncertainty_px: Annotated[
        float, Field(description="Its standard uncertainty (one standard deviation), px.", examples=[6.2])
    ]


class ImagePoseRead(ResponseModel):
    """One image of one target and the camera's pose in it."""

    measurement_id: Annotated[
        str,
        Field(
            description="Id of the image's measurement of this target.",
            examples=["mea_01m7y27rjab1ph2rjyj45ywg3m"],
        ),
    ]
    pose_id: Annotated[str, Field(description=POSE_ID, examples=["P1"])]
    cycle: Annotated[int | None, Field(description=CYCLE, examples=[1])]
    target_id: Annotated[
        str,
        Field(
            description="Id of the target in whose frame the pose is.",
            examples=["tgt_01m7y27rhc7t5mkfp8hz3c61jj"],
        ),
    ]
    focus_group: Annotated[str, Field(description=FOCUS_GROUP, examples=["default"])]
    used: Annotated[
        bool,
        Field(
            description="Whether the image is in the estimate and a visit to its pose. `rejection` says why not; with "
            "`per_image` an image may have a pose and not be used, as it determines the focal length weakly.",
            examples=[True],
        ),
    ]
    rejection: Annotated[ReasonRead | None, Field(description="Why the image is not used; null where it is.")]
    T_camera_target: Annotated[
        Matrix | None,
        Field(
            description="4 x 4, mm: maps points of the target into the camera frame. Null where the estimator gives no "
            "pose.",
            examples=[
                [
                    [0.98, 0.17, -0.1, -96.4],
                    [-0.16, 0.98, 0.12, -70.2],
                    [0.12, -0.1, 0.99, 612.8],
                    [0, 0, 0, 1],
                ]
            ],
        ),
    ]
    pose: Annotated[
        CameraPoseRead | None,
        Field(
            description="The camera in the target frame with its covariance; `covariance_given_camera` is without what "
            "all images of the focus group share."
        ),
    ]
    focal: Annotated[
        OwnFocalRead | None,
        Field(
            description="The focal length that the image has to itself, with the estimators `per_image`, "
            "`per_image_session_prior` and `per_image_fixed_pp`; null where images share one, it was given, or the "
            "image is not in the estimate."
        ),
    ]
    rms_px: Annotated[
        float | None,
        Field(
            description="Root mean square of the residual distances of the points used, px; null without a pose.",
            examples=[0.061],
        ),
    ]


class CameraPosesAnalysis(EstimatedAnalysis):
    """The camera's pose of every image in which the target was found."""

    camera_poses: Annotated[
        list[ImagePoseRead], Field(description="In the order of pose (P2 before P10), cycle and image.")
    ]
