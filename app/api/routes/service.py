"""Health, metrics, progress events, and the documentation page."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from pathlib import Path

from fastapi import APIRouter, Response
from fastapi.responses import JSONResponse, StreamingResponse
from starlette.concurrency import run_in_threadpool

from app.api.contract import Service, ServiceDep, contract_router, problems
from app.api.files import WholeFile
from app.api.problems import problem_response
from app.api.schemas.service import HealthCheck, Liveness, Readiness
from app.errors import NotFound
from app.services.health import check_health
from app.services.progress import Progress, read_progress
from app.settings import program_version

router = contract_router(tags=["service"])
documentation = APIRouter(include_in_schema=False)

EVENT_INTERVAL_S = 0.5
_KEEP_ALIVE_EVERY = 30  # intervals without news
_WEB = Path(__file__).parent.parent.parent / "web" / "docs"
_DOCS_FILES = {
    "swagger-ui.css": "text/css",
    "swagger-ui-bundle.js": "text/javascript",
    "start.js": "text/javascript",
}


@router.get("/livez", openapi_extra={"security": []})
async def get_liveness() -> Liveness:
    """Tell that the process answers."""
    return Liveness(status="ok")


@router.get(
    "/readyz",
    response_model=Readiness,
    responses={503: problems(503)[503]},
    openapi_extra={"security": []},
)
def get_readiness(service: ServiceDep) -> Readiness | JSONResponse:
    """Tell whether the service can do its work, each part by name."""
    checks = check_health(service.installation, service.runner)
    failing = [check for check in checks if not check.ok]
    if service.stopping:
        return problem_response(503, "not_ready", "The service is stopping.", "Wait for its restart.")
    if failing:
        return problem_response(
            503,
            "not_ready",
            "The service cannot do its work: " + " ".join(check.detail for check in failing),
            "Run `gridpose doctor` on the server.",
            [(check.name, check.detail) for check in failing],
            {"Retry-After": "5"},
        )
    return Readiness(
        status="ok",
        version=program_version(),
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
        **problems(),
    },
)
def get_metrics(service: ServiceDep) -> Response:
    """Report the service's numbers to Prometheus."""
    return Response(service.metrics.render(), media_type="text/plain; version=0.0.4; charset=utf-8")


@router.get(
    "/v1/sessions/{session_id}/events",
    response_class=StreamingResponse,
    responses={
        200: {
            "description": "Server-sent events: `progress` with the session's counts at every change, `deleted` last.",
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
        },
        **problems(404),
    },
)
async def stream_events(session_id: str, service: ServiceDep) -> StreamingResponse:
    """Follow a session's progress; polling the session is always enough."""
    first = await run_in_threadpool(read_progress, service.installation.database, session_id)
    if first is None:
        raise NotFound.of("session")
    return StreamingResponse(_follow(service, first), media_type="text/event-stream")


async def _follow(service: Service, progress: Progress) -> AsyncIterator[str]:
    yield _event("progress", progress)
    quiet = 0
    while not service.stopping:
        await asyncio.sleep(EVENT_INTERVAL_S)
        latest = await run_in_threadpool(read_progress, service.installation.database, progress.session_id)
        if latest is None:
            yield f"event: deleted\ndata: {json.dumps({'session_id': progress.session_id})}\n\n"
            return
        quiet = quiet + 1 if latest == progress else 0
        if latest != progress:
            progress = latest
            yield _event("progress", progress)
        elif quiet % _KEEP_ALIVE_EVERY == 0:
            yield ": still here\n\n"


def _event(name: str, progress: Progress) -> str:
    document = {"session_id": progress.session_id, "counts": progress.counts, "pending": progress.pending}
    return f"event: {name}\ndata: {json.dumps(document)}\n\n"


@documentation.get("/docs")
def get_docs_page() -> WholeFile:
    """Serve the documentation page; every file of it is ours, since shop floors are offline."""
    return WholeFile(_WEB / "index.html", media_type="text/html")


@documentation.get("/docs/{name}")
def get_docs_file(name: str) -> WholeFile:
    """Serve one of the page's own files."""
    if name not in _DOCS_FILES:
        raise NotFound.of("file")
    return WholeFile(_WEB / name, media_type=_DOCS_FILES[name], headers={"Cache-Control": "max-age=3600"})
