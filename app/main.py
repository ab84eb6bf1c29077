"""The application, put together."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import structlog
from fastapi import FastAPI
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool

from app.api.contract import Service
from app.api.edge import Edge
from app.api.metrics import Metrics
from app.api.openapi import openapi_document
from app.api.problems import install_problem_handlers
from app.api.routes import (
    analyses,
    keys,
    kinematics,
    measured_poses,
    measurements,
    plots,
    poses,
    robots,
    sessions,
    targets,
)
from app.api.routes import service as service_routes
from app.api.security import KeyCheck
from app.jobs.overlay import OverlayPainter
from app.records.lock import AlreadyLocked, FileLock
from app.services.analyses.desk import AnalysisDesk
from app.services.installation import Installation
from app.settings import Settings, program_version

log = structlog.get_logger(__name__)


class AlreadyServed(Exception):
    """Another process serves this data folder, or runs its jobs."""


def create_app(settings: Settings) -> FastAPI:
    """Return the application for `settings`.

    Nothing is opened, made or started before the application's lifespan begins, so that its OpenAPI document can be
    had without a data folder. `app.state.begin_shutdown()` may be called when the process is told to end, before the
    server waits for open connections.
    """
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        service = await run_in_threadpool(_start, settings, metrics)
        app.state.service = service
        app.state.begin_shutdown = service.begin_shutdown
        try:
            yield
        finally:
            service.begin_shutdown()
            await run_in_threadpool(_stop, service)

    app = FastAPI(
        title="Gridpose",
        version=program_version(),
        docs_url=None,
        redoc_url=None,
        openapi_url="/openapi.json",
        redirect_slashes=False,
        generate_unique_id_function=_operation_id,
        lifespan=lifespan,
    )
    for router in (
        targets.router,
        robots.router,
        sessions.router,
        poses.router,
        measured_poses.router,
        measurements.router,
        analyses.router,
        kinematics.router,
        kinematics.plans,
        plots.router,
        keys.router,
        service_routes.router,
        service_routes.documentation,
    ):
        app.include_router(router)
    install_problem_handlers(app)
    app.add_middleware(KeyCheck)
    app.add_middleware(Edge, metrics=metrics)

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = openapi_document(app)
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]
    return app


def _start(settings: Settings, metrics: Metrics) -> Service:
    """Open the data folder, clear what a crash left, and start the embedded runner."""
    settings.data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
    head_lock = FileLock(settings.data_dir / "head.lock")
    try:
        head_lock.acquire()
    except AlreadyLocked as error:
        raise AlreadyServed("Another `gridpose serve` uses this data folder.") from error
    installation = Installation.open(settings)
    leftovers = installation.blobs.prepare()
    if leftovers:
        log.info("interrupted_uploads_removed", files=leftovers)
    runner = None
    if settings.worker_count > 0:
        runner = installation.runner()
        try:
            runner.start()
        except AlreadyLocked as error:
            installation.close()
            head_lock.release()
            raise AlreadyServed(
                "Another process runs the jobs of this data folder; stop it or set GRIDPOSE_WORKERS=0."
            ) from error
    metrics.watch(installation, runner)
    painter = OverlayPainter(settings.max_image_pixels)
    analyses = AnalysisDesk(settings.max_image_pixels)
    return Service(installation, runner, painter, analyses, metrics, head_lock)


def _stop(service: Service) -> None:
    if service.runner is not None:
        service.runner.stop()
    service.painter.close()
    service.analyses.close()
    service.installation.close()
    service.head_lock.release()


def _operation_id(route: APIRoute) -> str:
    return route.name
