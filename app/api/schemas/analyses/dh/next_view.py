"""The most informative next views as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.analyses.common import AnalysisHead, Matrix
from app.api.schemas.common import Identifier, RequestModel, ResponseModel, Text
from app.api.schemas.fields import TargetId

NextViewPurpose = TypeAliasType(
    "NextViewPurpose",
    Annotated[Literal["intrinsics"], Field(description="What further views are to determine: the camera.")],
)
_Pixel = Annotated[list[float], Field(min_length=2, max_length=2)]


class NextViewCreate(RequestModel):
    """What to determine, and how many views to suggest."""

    purpose: Annotated[NextViewPurpose, Field(description="`intrinsics`: the camera.")] = "intrinsics"
    count: Annotated[int, Field(ge=1, le=50, description="Views to suggest.")] = 3
    focus_group: Annotated[
        Text | None,
        Field(description="The focus group whose camera counts; needed where the session has several."),
    ] = None
    target_id: Annotated[
        Identifier | None, Field(description="The target to look at; null: the session's first.")
    ] = None


class NextViewUncertainty(ResponseModel):
    """How uncertain the camera is."""

    projection_rms_px: Annotated[
        float,
        Field(description="Standard uncertainty of a pixel at a fixed direction, rms over the image, px."),
    ]
    focal_relative_uncertainty: Annotated[float, Field(description="u(f)/f.")]


class SuggestedView(ResponseModel):
    """A view to take."""

    T_target_camera: Annotated[
        Matrix, Field(description="4 x 4, mm: maps points of the camera frame into the target frame.")
    ]
    joint_angles_deg: Annotated[
        list[float] | None, Field(description="Joint angles that take the robot there; null: not known.")
    ]
    view_distance_mm: Annotated[float, Field(description="From the camera to the target's middle, mm.")]
    view_tilt_deg: Annotated[
        float, Field(description="Between the optical axis and the target's normal, degrees.")
    ]
    target_middle_px: Annotated[_Pixel, Field(description="Where the target's middle appears, [u, v], px.")]
    expected_uncertainty_now: Annotated[
        NextViewUncertainty, Field(description="Before this view, with those suggested before it taken.")
    ]
    expected_uncertainty_after: Annotated[NextViewUncertainty, Field(description="With this view, too.")]


class NextViewAnalysis(AnalysisHead):
    """Views to take next, the most informative first (after AprilCal)."""

    purpose: Annotated[NextViewPurpose, Field(description="What was asked for.")]
    focus_group: Annotated[str, Field(description="The focus group whose camera counts.")]
    target_id: TargetId
    suggestions: Annotated[list[SuggestedView], Field(description="In the order to take them.")]
