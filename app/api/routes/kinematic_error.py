"""/v1/sessions/{session_id}/dh/error-map"""

from __future__ import annotations

from fastapi import Request, Response

from app.api.dependencies import SessionPath
from app.api.representations import (
    CSV_CONTENT,
    ETAG_HEADER,
    FormDep,
    KnownTags,
    answer_in_form,
)
from app.api.routes.joint_noise import OTHER_RESPONSES, WorkspaceSettingsDep
from app.api.routes.plots import answer_plot, plot_responses
from app.api.routing import api_router
from app.api.schemas.analyses import KinematicErrorAnalysis

router = api_router(prefix="/v1/sessions/{session_id}/dh", tags=["analyses"])


@router.get(
    "/error-map",
    response_model=KinematicErrorAnalysis,
    responses={200: {"headers": ETAG_HEADER, "content": CSV_CONTENT}, **OTHER_RESPONSES},
)
async def get_error_map(
    session_id: SessionPath, request: Request, form: FormDep, settings: WorkspaceSettingsDep
) -> Response:
    """Map how far the robot is from where its nominal parameters put it, with the uncertainty, over the workspace.

    By the model that `GET .../dh` takes with `method=global` and `model=auto`.
    """
    return await answer_in_form(
        request, "kinematic_error", KinematicErrorAnalysis, session_id, settings, form
    )


@router.get(
    "/error-map.svg",
    response_class=Response,
    responses=plot_responses(
        "Median position error and its standard uncertainty over distance from the first axis and "
        "height, where poses were measured, and the place of the largest error."
    ),
)
async def get_error_map_plot(
    session_id: SessionPath, request: Request, settings: WorkspaceSettingsDep, known: KnownTags = None
) -> Response:
    """Draw the position error of the nominal robot over its workspace."""
    return await answer_plot(request, "error_map", session_id, settings, known)
