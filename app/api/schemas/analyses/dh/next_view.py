"""The most informative next views as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.analyses.common import AnalysisHead, Matrix
from app.api.schemas.analyses.dh.plan import MAX_PLANNED_POSES, PoseToPlan
from app.api.schemas.common import Identifier, RequestModel, ResponseModel, Text
from app.api.schemas.fields import TargetId

NextViewPurpose = TypeAliasType(
    "NextViewPurpose",
    Annotated[
        Literal["intrinsics", "hand_eye", "dh"], Field(description="What further views are to determine.")
    ],
)
_Pixel = Annotated[list[float], Field(min_length=2, max_length=2)]


class NextViewCreate(RequestModel):
    """What to determine, and how many views to suggest."""

    purpose: Annotated[
        NextViewPurpose,
        Field(
            description="`intrinsics`: the camera. `hand_eye`: the camera on the flange; needs commanded poses. `dh`: "
            "the robot's chain; needs joint angles."
        ),
    ] = "intrinsics"
    count: Annotated[int, Field(ge=1, le=50, description="Views to suggest.")] = 3
    focus_group: Annotated[
        Text | None,
        Field(description="The focus group whose camera counts; needed where the session has several."),
    ] = None
    target_id: Annotated[
        Identifier | None, Field(description="The target to look at; null: the session's first.")
    ] = None
    candidates: Annotated[
        Annotated[list[PoseToPlan], Field(min_length=1, max_length=MAX_PLANNED_POSES)] | None,
        Field(
            description="Poses to choose from, each once at most: those that the robot may go to. They need the "
            "robot's model, and commanded poses in its base unless the purpose is `dh`. Null: any view within reach."
        ),
    ] = None


class NextViewUncertainty(ResponseModel):
    """How uncertain what is asked for is; fields of other purposes are null."""

    projection_rms_px: Annotated[
        float | None,
        Field(
            description="`intrinsics`: standard uncertainty of a pixel at a fixed direction, rms over the image, px."
        ),
    ]
    focal_relative_uncertainty: Annotated[float | None, Field(description="`intrinsics`: u(f)/f.")]
    length_rms_mm: Annotated[
        float | None,
        Field(
            description="`hand_eye`: standard uncertainty of the camera's position on the flange, rms over the axes. "
            "`dh`: of the chain's lengths that are determined, rms. mm."
        ),
    ]
    angle_rms_deg: Annotated[
        float | None,
        Field(
            description="`hand_eye`: of the camera's rotation on the flange, rms over the axes. `dh`: of the chain's "
            "angles that are determined, rms. Degrees."
        ),
    ]


class SuggestedView(ResponseModel):
    """A view to take."""

    T_target_camera: Annotated[
        Matrix, Field(description="4 x 4, mm: maps points of the camera frame into the target frame.")
    ]
    T_base_flange: Annotated[
        Matrix | None,
        Field(
            description="4 x 4, mm: the flange's pose to command, in the robot's base; null with `intrinsics` and no "
            "candidates."
        ),
    ]
    joint_angles_deg: Annotated[
        list[float] | None,
        Field(
            description="Joint angles that take the robot there, those of a candidate, or each within 20 degrees of "
            "where its joint has been; null: not known."
        ),
    ]
    instruction: Annotated[
        str, Field(description="The view in one line for whoever stands at the camera; image directions.")
    ]
    view_distance_mm: Annotated[float, Field(description="From the camera to the target's middle, mm.")]
    view_tilt_deg: Annotated[
        float, Field(description="Between the optical axis and the target's normal, degrees.")
    ]
    target_middle_px: Annotated[_Pixel, Field(description="Where the target's middle appears, [u, v], px.")]
    expected_uncertainty_now: Annotated[
        NextViewUncertainty,
        Field(
            description="Before this view, with those suggested before it taken; the print taken as its nominal grid, "
            "so that analyses, which allow for its shape, may state more."
        ),
    ]
    expected_uncertainty_after: Annotated[NextViewUncertainty, Field(description="With this view, too.")]


class NextViewAnalysis(AnalysisHead):
    """Views to take next, the most informative first (after AprilCal)."""

    purpose: Annotated[NextViewPurpose, Field(description="What was asked for.")]
    focus_group: Annotated[str, Field(description="The focus group whose camera counts.")]
    target_id: TargetId
    suggestions: Annotated[list[SuggestedView], Field(description="In the order to take them.")]
