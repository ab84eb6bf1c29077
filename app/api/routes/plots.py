"""/v1/sessions/{session_id}: analyses as plots, and the camera as a file"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from app.api.dependencies import AppContext, SessionPath, get_app_context
from app.api.representations import ETAG_HEADER, KnownTags, answer_analysis, binary_content, stated_media_type
from app.api.routes.analyses import (
    EstimatorQuery,
    LensModelQuery,
    ModelQuery,
    RefineQuery,
    SourceQuery,
    ToleranceQuery,
)
from app.api.routing import api_router, problem_responses
from app.api.schemas.analyses import CameraFileFormat
from app.api.schemas.common import Text
from app.services import poses
from app.services.queries import POSE_ID

SVG = "image/svg+xml"
_CONTENT = {SVG: {"schema": {"type": "string"}}, **binary_content()}

router = api_router(prefix="/v1/sessions/{session_id}", tags=["analyses"])

PoseQuery = Annotated[
    str | None, Query(pattern=POSE_ID, description="This pose alone; all of them by default, 40 at most.")
]
FocusGroupQuery = Annotated[
    Text | None, Query(description="This focus group alone; all of them by default, 40 at most.")
]


@dataclass
class PosePlot:
    """What a plot of poses shows, by the query."""

    pose_id: PoseQuery = None
    estimator: EstimatorQuery = "pooled"
    source: SourceQuery = "images"


@dataclass
class CameraPlot:
    """What a plot of cameras shows, by the query."""

    estimator: EstimatorQuery = "pooled"
    focus_group: FocusGroupQuery = None


def robot_plot_settings(
    estimator: EstimatorQuery = "pooled",
    model: ModelQuery = "auto",
    source: SourceQuery = "images",
    joint_tolerance_deg: ToleranceQuery = 0.02,
) -> dict[str, str]:
    """Return the settings of a plot of the identified robot."""
    return {
        "estimator": estimator,
        "model": model,
        "source": source,
        "joint_tolerance_deg": repr(joint_tolerance_deg),
    }


RobotPlotDep = Annotated[dict[str, str], Depends(robot_plot_settings)]
PosePlotDep = Annotated[PosePlot, Depends()]
CameraPlotDep = Annotated[CameraPlot, Depends()]


def plot_responses(shown: str) -> dict[int | str, dict[str, Any]]:
    """Return what the contract states of a plot's answers; `shown` is what the plot shows."""
    return {
        200: {"description": shown, "content": _CONTENT, "headers": ETAG_HEADER},
        304: {"description": "The client has this plot already.", "headers": ETAG_HEADER},
        **problem_responses(404, 409),
    }


@router.get(
    "/repeatability/scatter.svg",
    response_class=Response,
    responses=plot_responses(
        "For every pose of two cycles or more its cycles about their mean in three projections, with the ellipsoid "
        "observed and that of the instrument's noise."
    ),
)
async def get_scatter_plot(
    session_id: SessionPath, request: Request, chosen: PosePlotDep, known: KnownTags = None
) -> Response:
    """Draw how the positions of each pose scatter, and how much of that is the instrument's."""
    return await _answer_for_poses(request, "scatter_plot", session_id, chosen, known)


@router.get(
    "/repeatability/drift.svg",
    response_class=Response,
    responses=plot_responses(
        "For every pose x, y, z and the orientation over time, or over the cycles where not every image states when it "
        "was taken, with the means of blocks of ten cycles and what chance alone would give."
    ),
)
async def get_drift_plot(
    session_id: SessionPath, request: Request, chosen: PosePlotDep, known: KnownTags = None
) -> Response:
    """Draw how the poses move over the cycles."""
    return await _answer_for_poses(request, "drift_plot", session_id, chosen, known)


@router.get(
    "/repeatability/steadiness.svg",
    response_class=Response,
    responses=plot_responses(
        "The motion that all poses share over the cycles, and each pose's own, with trend and largest step where they "
        "are significant, and second stopping points."
    ),
)
async def get_steadiness_plot(
    session_id: SessionPath, request: Request, chosen: PosePlotDep, known: KnownTags = None
) -> Response:
    """Draw whether the cycles are steady, and what moved; all poses are tested whichever is drawn."""
    return await _answer_for_poses(request, "steadiness_plot", session_id, chosen, known)


@router.get(
    "/intrinsics/residuals.svg",
    response_class=Response,
    responses=plot_responses(
        "For every focus group the mean residuals over the image, and the residuals' size."
    ),
)
async def get_residual_map(
    session_id: SessionPath,
    request: Request,
    chosen: CameraPlotDep,
    known: KnownTags = None,
) -> Response:
    """Draw what the camera model leaves over, by place in the image."""
    return await _answer_for_cameras(request, "residual_map", session_id, chosen, known)


@router.get(
    "/intrinsics/lens.svg",
    response_class=Response,
    responses=plot_responses(
        "For every focus group the mean residual along the radius by Brown's lens model, by Kannala's and Brandt's, "
        "and by the one chosen; the radius that the images show, and where a model turns back."
    ),
)
async def get_lens_profile(session_id: SessionPath, request: Request, known: KnownTags = None) -> Response:
    """Draw why the lens model was chosen, by the pooled estimates."""
    return await answer_plot(request, "lens_profile_plot", session_id, {"estimator": "pooled"}, known)


@router.get(
    "/intrinsics/projection-uncertainty.svg",
    response_class=Response,
    responses=plot_responses(
        "For every focus group the standard uncertainty of a projected point at infinity, and the number of grid "
        "points, over the image; parts without points are hatched."
    ),
)
async def get_projection_map(
    session_id: SessionPath,
    request: Request,
    chosen: CameraPlotDep,
    known: KnownTags = None,
) -> Response:
    """Draw how certain the camera is, by place in the image; a rotation of the camera is compensated."""
    return await _answer_for_cameras(request, "projection_map", session_id, chosen, known)


@router.get(
    "/dh/joint-curves.svg",
    response_class=Response,
    responses=plot_responses(
        "For every joint what it turns by beyond its stated angle, with the 95 % band, the angles at which it was, and "
        "those at which it never was, hatched."
    ),
)
async def get_joint_curves_plot(
    session_id: SessionPath, request: Request, settings: RobotPlotDep, known: KnownTags = None
) -> Response:
    """Draw the joint curves of the identified robot; 409 `no_joint_curves` where the model has none."""
    return await answer_plot(request, "joint_curves_plot", session_id, settings, known)


@router.get(
    "/dh/identifiability.svg",
    response_class=Response,
    responses=plot_responses(
        "The axes and lengths of the nominal arm at one pose, with the parameters that the session's poses do not "
        "determine, and the reason of each group in words."
    ),
)
async def get_identifiability_plot(
    session_id: SessionPath, request: Request, settings: RobotPlotDep, known: KnownTags = None
) -> Response:
    """Draw what the poses cannot determine of the robot: `null_space` of `GET .../dh`."""
    return await answer_plot(request, "identifiability_plot", session_id, settings, known)


FormatQuery = Annotated[
    CameraFileFormat,
    Query(
        description="`opencv`: YAML of cv::FileStorage. `ros`: YAML of sensor_msgs/CameraInfo. `kalibr`: a camchain of "
        "one camera. `mrcal`: a .cameramodel."
    ),
]
FileGroupQuery = Annotated[
    Text | None,
    Query(description="The focus group whose camera is written; needed where the session has several."),
]
_FILE_TYPE = "application/yaml"


@router.get(
    "/intrinsics/export",
    response_class=Response,
    responses={
        200: {
            "description": "The file. It states the largest distance of a pixel from that of the estimated camera, "
            "within the radius that the images show.",
            "headers": ETAG_HEADER,
            "content": {
                _FILE_TYPE: {"schema": {"type": "string"}},
                "text/plain": {"schema": {"type": "string"}},
            },
        },
        304: {"description": "The client has this file already.", "headers": ETAG_HEADER},
        **problem_responses(404, 409),
    },
)
async def get_camera_file(
    session_id: SessionPath,
    request: Request,
    file_format: Annotated[FormatQuery, Query(alias="format")],
    estimator: EstimatorQuery = "pooled",
    refine_target: RefineQuery = False,
    lens_model: LensModelQuery = None,
    focus_group: FileGroupQuery = None,
    known: KnownTags = None,
) -> Response:
    """Write the session's camera as a file of another program.

    A lens model that the format lacks is converted to the nearest it has; a difference of more than half a pixel is
    409 `not_representable`.
    """
    settings: dict[str, str] = {"format": file_format, "estimator": estimator}
    settings |= {"refine_target": "true"} if refine_target else {}
    settings |= {"lens_model": lens_model} if lens_model is not None else {}
    settings |= {"focus_group": focus_group} if focus_group is not None else {}
    kind, name = ("text/plain", "cameramodel") if file_format == "mrcal" else (_FILE_TYPE, "yaml")
    found = await answer_analysis(request, "camera_file", session_id, settings, known, media_type=kind)
    if found.status_code == 200:
        found.headers["Content-Disposition"] = f'attachment; filename="camera.{name}"'
    return found


async def _answer_for_poses(
    request: Request, analysis: str, session_id: str, chosen: PosePlot, known: str | None
) -> Response:
    settings: dict[str, str] = {"estimator": chosen.estimator, "source": chosen.source}
    if chosen.pose_id is not None:
        settings["pose_id"] = chosen.pose_id
        await run_in_threadpool(_check_pose, await get_app_context(request), session_id, chosen.pose_id)
    return await answer_plot(request, analysis, session_id, settings, known)


async def _answer_for_cameras(
    request: Request, analysis: str, session_id: str, chosen: CameraPlot, known: str | None
) -> Response:
    settings: dict[str, str] = {"estimator": chosen.estimator}
    if chosen.focus_group is not None:
        settings["focus_group"] = chosen.focus_group
    return await answer_plot(request, analysis, session_id, settings, known)


async def answer_plot(
    request: Request, analysis: str, session_id: str, settings: dict[str, str], known: str | None
) -> Response:
    """Answer with an analysis that is a drawing."""
    media_type = stated_media_type(request.headers.get("accept"), SVG)
    found = await answer_analysis(request, analysis, session_id, settings, known, media_type=media_type)
    found.headers["Vary"] = "Accept"
    return found


def _check_pose(service: AppContext, session_id: str, pose_id: str) -> None:
    with service.installation.database.read() as records:
        poses.get_pose(records, session_id, pose_id)
