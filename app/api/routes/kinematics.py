"""/v1/sessions/{session_id}/dh and /v1/robots/{robot_id}/dh-plan"""

from __future__ import annotations

import json
from typing import Annotated

from fastapi import Query, Response
from pydantic import Field

from app.api.contract import ServiceDep, contract_router, problems
from app.api.routes.analyses import (
    ETAG_HEADER,
    EstimatorQuery,
    KnownTags,
    SourceQuery,
    answer_analysis,
)
from app.api.schemas.kinematics import DhAnalysis, DhMethod
from app.api.schemas.planning import DhPlan, DhPlanCreate
from app.services.analyses.sweep_names import PATTERN, sweeps_setting
from app.services.plans import read_plan

router = contract_router(prefix="/v1/sessions/{session_id}", tags=["analyses"])

MethodQuery = Annotated[
    DhMethod,
    Query(
        description="`cpa`: circles through the positions of each joint's sweeps. `screw`: axes from their rotations. "
        "`combined`: both, with the encoders' angles, weighted by covariance. `global`: everything at once, from all "
        "poses; with images and the pooled estimator on the grid points themselves, the lens included."
    ),
]
ToleranceQuery = Annotated[
    float,
    Query(
        gt=0.0,
        le=5.0,
        allow_inf_nan=False,
        description="A sweep of a joint is a largest set of poses whose other joints agree within this, degrees.",
    ),
]
SweepName = Annotated[str, Field(max_length=8192, pattern=PATTERN)]
SweepQuery = Annotated[
    list[SweepName] | None,
    Query(
        max_length=200,
        description="A sweep by its poses, `JOINT:POSE,POSE,...`, as often as there are such, a joint's number from 1; "
        "`*` in a pose's name is any text, `?` one character: `1:j1-*`. A joint that is named has these sweeps alone; "
        "those of the others are recognised. All poses of a sweep must have the other joints at rest.",
    ),
]


@router.get(
    "/dh",
    response_model=DhAnalysis,
    responses={
        200: {"headers": ETAG_HEADER},
        304: {"description": "The client has this answer already.", "headers": ETAG_HEADER},
        **problems(404, 409, 422, 503),
    },
)
def get_dh(
    session_id: str,
    service: ServiceDep,
    method: MethodQuery = "global",
    estimator: EstimatorQuery = "pooled",
    source: SourceQuery = "images",
    joint_tolerance_deg: ToleranceQuery = 0.02,
    sweep: SweepQuery = None,
    known: KnownTags = None,
) -> Response:
    """Identify the robot's Denavit-Hartenberg parameters from poses at known joint angles."""
    settings = {
        "method": method,
        "estimator": estimator,
        "source": source,
        "joint_tolerance_deg": repr(joint_tolerance_deg),
    }
    if sweep:
        settings["sweeps"] = sweeps_setting(sweep)
    return answer_analysis(service, "dh", session_id, settings, known)


plans = contract_router(prefix="/v1/robots/{robot_id}", tags=["analyses"])


@plans.post("/dh-plan", response_model=DhPlan, responses=problems(404, 409, 413, 415, 422, 503))
def create_dh_plan(robot_id: str, body: DhPlanCreate, service: ServiceDep) -> Response:
    """Predict what poses would tell of a robot before it moves, and suggest those that would tell most.

    Nothing is stored. The robot's nominal parameters are used, and a grid straight before the camera at home.
    """
    with service.installation.database.read() as records:
        joints, target = read_plan(records, robot_id, body.target_id)
    document = service.analyses.plan(joints, target, body.model_dump(exclude={"target_id"}))
    ids = json.dumps({"robot_id": robot_id, "target_id": body.target_id})
    return Response(ids[:-1].encode() + b"," + document[1:], media_type="application/json")
