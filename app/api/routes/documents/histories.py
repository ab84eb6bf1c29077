"""/v1/robots/{robot_id}/history and /v1/reports/{report_id}/comparison: what reports say over time"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Path, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from app.analyses.history import (
    charts_of_tests,
    comparison_document,
    draw_charts,
    read_filed_report,
    read_history,
)
from app.api.dependencies import AppContextDep, ReportPath, RobotPath
from app.api.representations import (
    CSV_CONTENT,
    FormDep,
    KnownTags,
    answer_document,
    answer_drawing,
    binary_content,
    stated_media_type,
)
from app.api.routing import api_router, problem_responses
from app.api.schemas.documents.histories import ChartAxis, HistoryKind, ReportComparison, RobotHistory
from app.errors import Conflict
from app.http import RequesterDep, run_while_connected

SVG = "image/svg+xml"
router = api_router(prefix="/v1/robots/{robot_id}", tags=["analyses"])
comparisons = api_router(prefix="/v1/reports/{report_id}", tags=["analyses"])
_ETAG = {"ETag": {"description": "Changes with what the answer says.", "schema": {"type": "string"}}}
_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"headers": _ETAG, "content": CSV_CONTENT},
    304: {"description": "The client has this answer already.", "headers": _ETAG},
    **problem_responses(404, 409),
}
KindQuery = Annotated[HistoryKind | None, Query(description="Of this kind alone; all of them by default.")]
AxisQuery = Annotated[
    ChartAxis,
    Query(description="Sessions along the axis by the date of their measurement, or by their number."),
]
OtherReportPath = Annotated[str, Path(description="Id of the report that it is compared with.")]


@router.get("/history", response_model=RobotHistory, responses=_RESPONSES)
def get_robot_history(
    robot_id: RobotPath, service: AppContextDep, form: FormDep, kind: KindQuery = None
) -> Response:
    """Return a robot's figures over its sessions, from stored reports alone, with control limits and events.

    Each session counts by its latest report of a kind. Like is charted with like, from five sessions on: individuals
    with three-sigma limits, and an EWMA. False alarms of lasting changes come once in 370 sessions of a test in the
    mean.
    """
    found = read_history(service.installation.database, robot_id, kind)
    return answer_document("history", RobotHistory, found.document(), form)


@router.get(
    "/history.svg",
    response_class=Response,
    responses={
        200: {
            "description": "For every figure of five comparable sessions or more its control chart: individuals with "
            "limits, the EWMA, lasting changes, and events as dotted lines; 24 charts at most.",
            "content": {SVG: {"schema": {"type": "string"}}, **binary_content()},
            "headers": _ETAG,
        },
        304: {"description": "The client has this plot already.", "headers": _ETAG},
        **problem_responses(404, 409),
    },
)
async def get_robot_history_plot(
    robot_id: RobotPath,
    request: Request,
    service: AppContextDep,
    requester: RequesterDep,
    kind: KindQuery = None,
    axis: AxisQuery = "date",
    known: KnownTags = None,
) -> Response:
    """Draw a robot's control charts; 409 `no_control_chart` where no five sessions are comparable."""
    found = await run_in_threadpool(read_history, service.installation.database, robot_id, kind)
    charts = charts_of_tests(found.tests, found.events, axis)
    if not charts:
        raise Conflict(
            "There is no control chart to draw: no five sessions of this robot that are comparable have a report.",
            "Measure the same poses under the same conditions again, and make a report of each session.",
            code="no_control_chart",
        )
    asked = service.analyses.run(
        ("history", robot_id, repr(charts)),
        requester,
        draw_charts,
        charts,
        f"History of {found.robot['name']}",
    )
    drawn = await run_while_connected(request, asked)
    return answer_drawing(drawn, stated_media_type(request.headers.get("accept"), SVG), known)


@comparisons.get("/comparison/{other_report_id}", response_model=ReportComparison, responses=_RESPONSES)
def get_report_comparison(
    report_id: ReportPath, other_report_id: OtherReportPath, service: AppContextDep, form: FormDep
) -> Response:
    """Compare the figures of two reports, the later with the earlier, with intervals and a conclusion in words.

    Says in what they are not comparable, and which conditions are not known: a change need not be the robot's then.
    """
    with service.installation.database.read() as records:
        first, second = (read_filed_report(records, one) for one in (report_id, other_report_id))
    return answer_document("report_comparison", ReportComparison, comparison_document(first, second), form)
