"""/v1/sessions/{session_id}/joint-noise"""

from __future__ import annotations

import json
import math
from typing import Annotated, Any

from fastapi import Depends, Query, Request, Response
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from app.api.dependencies import AppContextDep, SessionPath
from app.api.representations import (
    CSV_CONTENT,
    ETAG_HEADER,
    FormDep,
    KnownTags,
    answer_in_form,
)
from app.api.routes.analyses import SettingsDep, SourceQuery
from app.api.routes.plots import answer_plot, plot_responses
from app.api.routing import api_router, problem_responses
from app.api.schemas.analyses import JointNoiseAnalysis
from app.errors import InvalidContent
from app.services.robots import limits_setting

MAX_PREDICTIONS = 200
MAX_ANGLE_DEG = 36000.0

router = api_router(prefix="/v1/sessions/{session_id}/joint-noise", tags=["analyses"])
_Angles = Annotated[str, Field(max_length=400)]
AtQuery = Annotated[
    list[_Angles] | None,
    Query(
        max_length=MAX_PREDICTIONS,
        description="Joint angles to predict at, degrees, from the base: `at=0,-65,75,10,55,0`, as often as there are "
        "such.",
    ),
]
OTHER_RESPONSES: dict[int | str, dict[str, Any]] = {
    304: {"description": "The client has this answer already.", "headers": ETAG_HEADER},
    **problem_responses(404, 409),
}


async def workspace_settings(
    session_id: SessionPath, settings: SettingsDep, service: AppContextDep, source: SourceQuery = "images"
) -> dict[str, str]:
    """Return the settings of a map over the workspace of the session's robot, whose limits count."""
    limits = await run_in_threadpool(limits_setting, service.installation.database, session_id)
    return settings | {"source": source, "limits": limits}


WorkspaceSettingsDep = Annotated[dict[str, str], Depends(workspace_settings)]


@router.get(
    "",
    response_model=JointNoiseAnalysis,
    responses={200: {"headers": ETAG_HEADER, "content": CSV_CONTENT}, **OTHER_RESPONSES},
)
async def get_joint_noise(
    session_id: SessionPath,
    request: Request,
    form: FormDep,
    settings: WorkspaceSettingsDep,
    at: AtQuery = None,
) -> Response:
    """Estimate the noise of the robot's joints from the scatter of repeated poses, and predict RP_l anywhere by it.

    The instrument's own noise is taken off where it is stated. Poses held out of the fit say how well it predicts.
    """
    if at:
        settings["at"] = json.dumps([_angles(text) for text in at])
    return await answer_in_form(request, "joint_noise", JointNoiseAnalysis, session_id, settings, form)


@router.get(
    "/map.svg",
    response_class=Response,
    responses=plot_responses(
        "Median and largest RP_l over distance from the first axis and height, and the worst place."
    ),
)
async def get_joint_noise_map(
    session_id: SessionPath, request: Request, settings: WorkspaceSettingsDep, known: KnownTags = None
) -> Response:
    """Draw the repeatability that the joints' noise predicts over the robot's workspace."""
    return await answer_plot(request, "joint_noise_map", session_id, settings, known)


def _angles(text: str) -> list[float]:
    """Return joint angles that are separated by commas."""
    try:
        angles = [float(part) for part in text.split(",")]
    except ValueError:
        angles = [math.nan]
    if not all(abs(angle) <= MAX_ANGLE_DEG for angle in angles):
        raise InvalidContent(
            "Joint angles to predict at are numbers, degrees, separated by commas.",
            "Write one angle for each joint: at=0,-65,75,10,55,0.",
            errors=[("at", f"{text[:80]!r} is no list of angles")],
        )
    return angles
