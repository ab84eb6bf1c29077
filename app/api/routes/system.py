"""Health, metrics, progress events, and the documentation page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Header, Request, Response
from fastapi.responses import JSONResponse, RedirectResponse, StreamingResponse
from starlette.concurrency import run_in_threadpool

from app.api.dependencies import AppContextDep, SessionPath
from app.api.event_streams import EventStream
from app.api.problems import problem_response
from app.api.responses import WholeFileResponse
from app.api.routing import api_router, problem_responses
from app.api.schemas.system import HealthCheck, Liveness, Readiness
from app.api.session_events import follow
from app.build import core_version
from app.errors import NotFound
from app.http import RequesterDep, key_of
from app.services.following import start

router = api_router(tags=["service"])
documentation = APIRouter(include_in_schema=False)

_WITHOUT_KEYS: dict[int | str, dict[str, Any]] = {
    403: {**problem_responses()[403], "description": "With GRIDPOSE_AUTH=off: not asked by this machine."}
}
_EVENTS = (
    "Server-sent events; the data of each is a JSON object. `measurement`, whenever a measurement's status changed: "
    "`measurement_id`, `pose_id`, `status` and `counts`, those of the session. `progress`, first of all, and where the "
    "counts changed otherwise, as when a measurement was deleted: `session_id`, `counts` and `pending` (how many are "
    "queued or running). `deleted`, last: `session_id`. An event states what holds when it is sent: changes of a "
    "measurement that follow each other closely come as one, and an event may come twice."
)
LastEventId = Annotated[
    str | None,
    Header(
        alias="Last-Event-ID",
        description="`id` of the last event that was received; browsers send it by themselves. Every measurement whose "
        "status changed since follows, also after a restart and from any process of the service. Without it, or where "
        "it is no id of an event, `measurement` events begin with the next change.",
    ),
]
_WEB = Path(__file__).parent.parent.parent / "web" / "docs"
_DOCS_FILES = {
    "swagger-ui.css": "text/css",
    "swagger-ui-bundle.js": "text/javascript",
    "start.js": "text/javascript",
}


@router.get("/livez", responses=_WITHOUT_KEYS, openapi_extra={"security": []})
async def get_liveness() -> Liveness:
    """Report that the process is alive."""
    return Liveness(status="ok")


@router.get(
    "/readyz",
    response_model=Readiness,
    response_model_exclude_unset=True,
    responses={**_WITHOUT_KEYS, 503: problem_responses()[503]},
    openapi_extra={"security": []},
)
async def get_readiness(request: Request, service: AppContextDep) -> Readiness | JSONResponse:
    """Return whether the service can do its work; with a valid key, each part by name.

    Database, disk and bucket are looked at every two seconds at most.
    """
    if service.stopping:
        return problem_response(503, "not_ready", "The service is stopping.", "Wait for its restart.")
    checks = await service.health.look()
    failing = [check for check in checks if not check.ok]
    shows_details = service.installation.settings.auth == "off" or key_of(request) is not None
    if failing:
        reasons = f": {' '.join(check.detail for check in failing)}" if shows_details else "."
        return problem_response(
            503,
            "not_ready",
            f"The service cannot do its work{reasons}",
            "Run `gridpose doctor` on the server.",
            [(check.name, check.detail) for check in failing] if shows_details else (),
            {"Retry-After": "5"},
        )
    if not shows_details:
        return Readiness(status="ok")
    return Readiness(
        status="ok",
        version=core_version(),
        checks=[HealthCheck(name=check.name, ok=check.ok, detail=check.detail) for check in checks],
    )


@router.get(
    "/metrics",
    response_class=Response,
    responses={
        200: {
            "description": "Prometheus' text format.",
            "content": {"text/plain": {"schema": {"type": "string"}}},
        },
        **problem_responses(),
    },
)
def get_metrics(service: AppContextDep) -> Response:
    """Report the service's numbers to Prometheus."""
    return Response(service.metrics.render(), media_type="text/plain; version=0.0.4; charset=utf-8")


@router.get(
    "/v1/sessions/{session_id}/events",
    response_class=StreamingResponse,
    responses={
        200: {
            "description": _EVENTS,
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
        },
        **problem_responses(404),
    },
)
async def stream_events(
    session_id: SessionPath,
    service: AppContextDep,
    key_id: RequesterDep,
    last_event_id: LastEventId = None,
) -> EventStream:
    """Follow a session's measurements until it is deleted or the key is no longer valid; polling is always enough.

    A key may follow eight sessions at a time; more are 503 `too_many_streams`.
    """
    first = await run_in_threadpool(start, service.installation.database, session_id, last_event_id)
    if first is None:
        raise NotFound.of("session")
    return service.streams.open(key_id, follow(service, key_id, session_id, first))


@documentation.get("/")
def get_start_page() -> RedirectResponse:
    """Lead people who open the service's address to the dashboard."""
    return RedirectResponse("/ui/")


@documentation.get("/docs")
def get_docs_page() -> WholeFileResponse:
    """Serve the documentation page; every file of it is ours, since shop floors are offline."""
    return WholeFileResponse(_WEB / "index.html", media_type="text/html")


@documentation.get("/docs/{name}")
def get_docs_file(name: str) -> WholeFileResponse:
    """Serve one of the page's own files."""
    if name not in _DOCS_FILES:
        raise NotFound.of("file")
    return WholeFileResponse(
        _WEB / name, media_type=_DOCS_FILES[name], headers={"Cache-Control": "max-age=3600"}
    )
