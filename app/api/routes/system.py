"""Health, metrics, progress events, and the documentation page."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Request, Response
from fastapi.responses import JSONResponse, RedirectResponse, StreamingResponse
from starlette.concurrency import run_in_threadpool

from app.api.dependencies import AppContext, AppContextDep, SessionPath
from app.api.event_streams import EventStream
from app.api.problems import problem_response
from app.api.responses import WholeFileResponse
from app.api.routing import api_router, problem_responses
from app.api.schemas.system import HealthCheck, Liveness, Readiness
from app.build import core_version
from app.errors import NotFound, ServiceError
from app.http import RequesterDep, key_of
from app.services.keys import is_in_force
from app.services.sessions import Progress, read_progress

router = api_router(tags=["service"])
documentation = APIRouter(include_in_schema=False)

_KEEP_ALIVE_S = 15.0
"""How long a stream is silent where nothing happens."""
_KEEP_ALIVE = ": still here\n\n"
_WITHOUT_KEYS: dict[int | str, dict[str, Any]] = {
    403: {**problem_responses()[403], "description": "With GRIDPOSE_AUTH=off: not asked by this machine."}
}
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
    responses={**_WITHOUT_KEYS, 503: problem_responses(503)[503]},
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
            "description": "Server-sent events: `progress` with the session's counts at every change, `deleted` last.",
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
        },
        **problem_responses(404, 503),
    },
)
async def stream_events(session_id: SessionPath, service: AppContextDep, key_id: RequesterDep) -> EventStream:
    """Follow a session's progress until it is deleted or the key is no longer valid; polling is always enough.

    A key may follow eight sessions at a time; more are 503 `too_many_streams`.
    """
    first = await run_in_threadpool(read_progress, service.installation.database, session_id)
    if first is None:
        raise NotFound.of("session")
    return service.streams.open(key_id, _follow(service, key_id, first))


async def _follow(service: AppContext, key_id: str | None, progress: Progress) -> AsyncIterator[str]:
    yield _event("progress", progress)
    sent_s = time.monotonic()
    with service.news.following(progress.session_id) as news:
        while not service.stopping:
            await news.wait()
            try:
                is_allowed, latest = await run_in_threadpool(_look, service, key_id, progress.session_id)
            except ServiceError:  # it is logged where it arose; a busy database passes
                yield _KEEP_ALIVE
                continue
            if not is_allowed:
                return
            if latest is None:
                yield f"event: deleted\ndata: {json.dumps({'session_id': progress.session_id})}\n\n"
                return
            if latest != progress:
                progress, sent_s = latest, time.monotonic()
                yield _event("progress", progress)
            elif time.monotonic() - sent_s >= _KEEP_ALIVE_S:
                sent_s = time.monotonic()
                yield _KEEP_ALIVE


def _look(service: AppContext, key_id: str | None, session_id: str) -> tuple[bool, Progress | None]:
    """Return whether the stream's key is still valid, and the session's progress."""
    if key_id is not None and not is_in_force(service.installation, key_id):
        return False, None
    return True, read_progress(service.installation.database, session_id)


def _event(name: str, progress: Progress) -> str:
    document = {"session_id": progress.session_id, "counts": progress.counts, "pending": progress.pending}
    return f"event: {name}\ndata: {json.dumps(document)}\n\n"


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
