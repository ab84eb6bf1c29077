"""/v1/sessions/{session_id}: analyses of the stored measurements"""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import Depends, Query, Request, Response
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from app.analyses.documents.sweep_names import PATTERN, sweeps_setting
from app.api.dependencies import SessionPath, get_app_context
from app.api.representations import (
    CSV_CONTENT,
    ETAG_HEADER,
    POSTED_ANALYSIS,
    FormDep,
    PostedFormDep,
    answer_in_form,
)
from app.api.routes.documents.qualifications import qualification_settings
from app.api.routing import api_router, problem_responses
from app.api.schemas.analyses import (
    BudgetMethod,
    CameraPosesAnalysis,
    ComparisonAnalysis,
    DhAnalysis,
    DhMethod,
    DhModel,
    DhUncertaintyMethod,
    HandEyeAnalysis,
    IntrinsicsAnalysis,
    LensModel,
    NextViewAnalysis,
    NextViewCreate,
    QualificationAnalysis,
    QualificationCreate,
    RepeatabilityAnalysis,
)
from app.api.schemas.common import PoseTag
from app.api.schemas.fields import Estimator, Source
from app.errors import InvalidContent
from app.services.robots import limits_setting

router = api_router(prefix="/v1/sessions/{session_id}", tags=["analyses"])
_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {
        "headers": ETAG_HEADER,
        "content": CSV_CONTENT,
    },
    304: {"description": "The client has this answer already.", "headers": ETAG_HEADER},
    **problem_responses(404, 409),
}
EstimatorQuery = Annotated[
    Estimator,
    Query(
        description="`pooled`: one camera for all images of a focus group. `pooled_free_focal`: the same with a focal "
        "length for each image. `per_image`: every image by itself. `per_image_session_prior`: the same with the lens "
        "of the session's other images as its prior. `per_image_fixed_pp`: the same with the principal point held. "
        "`given`: the session's intrinsics."
    ),
]
SourceQuery = Annotated[
    Source,
    Query(
        description="`images`: poses estimated from images. `measured_poses`: those another instrument measured."
    ),
]
RefineQuery = Annotated[
    bool,
    Query(
        description="Estimate the target's own shape, too (print errors, bow), and the camera before the target as it "
        "is; takes images that show it from eight directions or more. Of no effect on poses of another instrument."
    ),
]
BudgetQuery = Annotated[
    BudgetMethod,
    Query(
        description="How the budget combines uncertainties. `gum`: by the law of propagation. `monte_carlo`: also "
        "by sampling the inputs (GUM Supplement 1), with whether both agree."
    ),
]
WitnessQuery = Annotated[
    PoseTag | None,
    Query(
        description="A pose that was revisited in every cycle: its slow motion is that of mount, target or room. It is "
        "reported in `witness`."
    ),
]
SubtractQuery = Annotated[
    bool,
    Query(
        description="Subtract the witness's slow motion from all positions before repeatability is computed."
    ),
]
LensModelQuery = Annotated[
    LensModel | None,
    Query(
        description="The lens model of the pooled estimators, whatever the images ask for; without it, Brown's unless "
        "the images contradict it."
    ),
]


def image_settings(
    estimator: EstimatorQuery = "pooled", refine_target: RefineQuery = False
) -> dict[str, str]:
    """Return the settings of every analysis of images."""
    return {"estimator": estimator} | ({"refine_target": "true"} if refine_target else {})


SettingsDep = Annotated[dict[str, str], Depends(image_settings)]


@router.get("/intrinsics", response_model=IntrinsicsAnalysis, responses=_RESPONSES)
async def get_intrinsics(
    session_id: SessionPath,
    request: Request,
    form: FormDep,
    settings: SettingsDep,
    lens_model: LensModelQuery = None,
) -> Response:
    """Calibrate the session's camera from all its images, repeated poses or not."""
    settings |= {"lens_model": lens_model} if lens_model is not None else {}
    return await answer_in_form(request, "intrinsics", IntrinsicsAnalysis, session_id, settings, form)


@router.get("/repeatability", response_model=RepeatabilityAnalysis, responses=_RESPONSES)
async def get_repeatability(
    session_id: SessionPath,
    request: Request,
    form: FormDep,
    settings: SettingsDep,
    source: SourceQuery = "images",
    method: BudgetQuery = "gum",
    witness: WitnessQuery = None,
    subtract_witness: SubtractQuery = False,
) -> Response:
    """Give every pose's repeatability by ISO 9283, with intervals, noise floor, verdict and accuracy."""
    settings |= {"source": source} | ({"method": method} if method != "gum" else {})
    if witness is not None:
        settings |= {"witness": witness} | ({"subtract_witness": "true"} if subtract_witness else {})
    elif subtract_witness:
        raise InvalidContent(
            "subtract_witness says nothing without a witness.",
            "Name the pose that was revisited in every cycle: witness=POSE.",
            errors=[("witness", "is missing")],
        )
    return await answer_in_form(request, "repeatability", RepeatabilityAnalysis, session_id, settings, form)


@router.get("/camera-poses", response_model=CameraPosesAnalysis, responses=_RESPONSES)
async def get_camera_poses(
    session_id: SessionPath, request: Request, form: FormDep, settings: SettingsDep
) -> Response:
    """Give the camera's pose of every image in which the target was found, with its covariance.

    Images that were refused alone have one too: the session's camera is known from all of them.
    """
    return await answer_in_form(request, "camera_poses", CameraPosesAnalysis, session_id, settings, form)


@router.get("/hand-eye", response_model=HandEyeAnalysis, responses=_RESPONSES)
async def get_hand_eye(
    session_id: SessionPath, request: Request, form: FormDep, settings: SettingsDep
) -> Response:
    """Estimate where the camera sits on the flange and the targets lie in the base, from commanded poses.

    Commanded poses must state position and orientation. Without any, the robot's model at the commanded joint angles
    takes their place.
    """
    return await answer_in_form(request, "hand_eye", HandEyeAnalysis, session_id, settings, form)


@router.get("/comparison", response_model=ComparisonAnalysis, responses=_RESPONSES)
async def get_comparison(session_id: SessionPath, request: Request, form: FormDep) -> Response:
    """Compare every method on the same images: calibration (the paper's Table II) and repeatability (Table III)."""
    return await answer_in_form(request, "comparison", ComparisonAnalysis, session_id, {}, form)


@router.post(
    "/qualification",
    response_model=QualificationAnalysis,
    responses={**POSTED_ANALYSIS, **problem_responses(404, 409, 413, 415)},
)
async def create_qualification(
    session_id: SessionPath, body: QualificationCreate, request: Request, form: PostedFormDep
) -> Response:
    """Compare known lengths between poses with what the session measured of them.

    It qualifies camera, lens and target together, in the spirit of VDI/VDE 2634 and ASTM E2919. Nothing is stored:
    `POST .../qualifications` keeps the result.
    """
    settings = qualification_settings(body)
    return await answer_in_form(request, "qualification", QualificationAnalysis, session_id, settings, form)


@router.post(
    "/next-view",
    response_model=NextViewAnalysis,
    responses={**POSTED_ANALYSIS, **problem_responses(404, 409, 413, 415)},
)
async def create_next_view(
    session_id: SessionPath, body: NextViewCreate, request: Request, form: PostedFormDep
) -> Response:
    """Suggest the views that would make camera, hand-eye calibration or robot most certain, most informative first.

    Nothing is stored. Ask again after each image: what it showed counts then.
    """
    settings = {"purpose": body.purpose, "count": str(body.count)}
    database = (await get_app_context(request)).installation.database
    settings["limits"] = await run_in_threadpool(limits_setting, database, session_id)
    settings |= body.model_dump(include={"focus_group", "target_id"}, exclude_none=True)
    if body.candidates is not None:
        settings["candidates"] = json.dumps([pose.joint_angles_deg for pose in body.candidates])
    return await answer_in_form(request, "next_view", NextViewAnalysis, session_id, settings, form)


MethodQuery = Annotated[
    DhMethod,
    Query(
        description="`cpa`: circles through the positions of each joint's sweeps. `screw`: axes from their rotations. "
        "`combined`: both, with the encoders' angles, weighted by covariance. `global`: everything at once, from all "
        "poses; with images and the pooled estimator together with the errors of lens and prints."
    ),
]
ModelQuery = Annotated[
    DhModel,
    Query(
        description="Terms beyond the chain with method `global`: gears, compliance, wobble. `auto`: uncertainties "
        "allow for them, and they are part of the model where marginal likelihood and held-out poses speak for them. "
        "`dh`: the chain alone. `extended`: all terms, whatever the evidence."
    ),
]
UncertaintyQuery = Annotated[
    DhUncertaintyMethod,
    Query(
        description="`analytic`: the covariance of the fit. `monte_carlo`: also by sampling, with whether both agree "
        "(`parameter_sampling`); with `method=global` and `model=dh`."
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
    responses=_RESPONSES,
)
async def get_dh(
    session_id: SessionPath,
    request: Request,
    form: FormDep,
    settings: SettingsDep,
    method: MethodQuery = "global",
    model: ModelQuery = "auto",
    source: SourceQuery = "images",
    joint_tolerance_deg: ToleranceQuery = 0.02,
    sweep: SweepQuery = None,
    uncertainty: UncertaintyQuery = "analytic",
) -> Response:
    """Identify the robot's Denavit-Hartenberg parameters from poses at known joint angles."""
    settings |= {
        "method": method,
        "model": model,
        "source": source,
        "joint_tolerance_deg": repr(joint_tolerance_deg),
    }
    if uncertainty != "analytic":
        if method != "global" or model != "dh":
            raise InvalidContent(
                "Sampling is of the global fit of the chain alone.",
                "Add method=global and model=dh, or leave uncertainty out.",
                errors=[("uncertainty", "needs method=global and model=dh")],
            )
        settings["uncertainty"] = uncertainty
    if sweep:
        settings["sweeps"] = sweeps_setting(sweep)
    return await answer_in_form(request, "dh", DhAnalysis, session_id, settings, form)
