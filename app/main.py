"""The application: settings, middleware, routes, start and end."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool
from starlette.routing import BaseRoute

from app.analyses.reporting import ReportMaker
from app.analyses.service import AnalysisService
from app.api.dependencies import AppContext
from app.api.direct import DirectRoutes
from app.api.metrics import Metrics
from app.api.middleware.authentication import ApiKeyAuth
from app.api.middleware.compression import Compression
from app.api.middleware.loopback import LoopbackOnly
from app.api.middleware.requests import RequestMiddleware
from app.api.openapi import openapi_document
from app.api.problems import install_problem_handlers
from app.api.routes import (
    analyses,
    images,
    joint_noise,
    kinematic_error,
    measured_poses,
    measurements,
    plots,
    poses,
    robots,
    sessions,
    system,
    targets,
)
from app.api.routes.access import audit, keys
from app.api.routes.documents import histories, qualifications, reports, robot_events, webhooks
from app.build import program_version
from app.delivery import Delivery
from app.jobs.painting import ImagePainter
from app.jobs.worker_init import keep_compiled_code
from app.logs import Logger
from app.records.file_lock import AlreadyLocked, FileLock
from app.services.following import SessionNews
from app.services.health import HealthWatch
from app.services.installation.binding import refuse_foreign_folder
from app.services.installation.context import ServiceContext
from app.services.keys import KeyUse
from app.services.maintenance.chores import Maintenance, chores
from app.settings import Settings
from app.web import PageRefusals
from app.web import routers as dashboard

log = Logger(__name__)


class AlreadyServed(Exception):
    """Another process serves this data folder, or runs its jobs."""


def create_app(settings: Settings) -> FastAPI:
    """Return the application for `settings`.

    Nothing is opened, made or started before the application's lifespan begins, so that its OpenAPI document can be
    had without a data folder. `app.state.begin_shutdown()` may be called when the process is asked to end, before the
    server waits for open connections; not from a signal handler, since it takes locks.
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
        lifespan=lifespan,
        routes=_routes(),
    )
    install_problem_handlers(app)
    app.add_middleware(DirectRoutes, routes=images.router.routes)
    app.add_middleware(ApiKeyAuth)
    app.add_middleware(PageRefusals)
    app.add_middleware(Compression)
    if settings.auth == "off":
        app.add_middleware(LoopbackOnly)
    app.add_middleware(RequestMiddleware, metrics=metrics, trusted_proxies=settings.trusted_networks)

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = openapi_document(app)
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]
    return app


@cache
def _routes() -> list[BaseRoute]:
    """Return the routes of every application of this process.

    The framework analyses a router's functions on the first request that looks for a route in it, tens of
    milliseconds for all, and keeps what it found with the included router. Nothing in it is one application's.
    """
    api = APIRouter(generate_unique_id_function=_operation_id)
    for router in (
        targets.router,
        robots.router,
        sessions.router,
        poses.router,
        measured_poses.router,
        images.router,
        measurements.router,
        analyses.router,
        robots.plans,
        joint_noise.router,
        kinematic_error.router,
        plots.router,
        qualifications.router,
        reports.router,
        robot_events.router,
        histories.router,
        histories.comparisons,
        webhooks.router,
        keys.router,
        audit.router,
        system.router,
        system.documentation,
        *dashboard,
    ):
        api.include_router(router)
    return list(api.routes)


def _start(settings: Settings, metrics: Metrics) -> AppContext:
    """Open the data folder, clear what a crash left, and start the embedded runner."""
    refuse_foreign_folder(settings)
    settings.data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
    head_lock = FileLock(settings.data_dir / "head.lock")
    try:
        head_lock.acquire()
    except AlreadyLocked as error:
        raise AlreadyServed("Another `gridpose serve` uses this data folder.") from error
    installation = ServiceContext.open(settings, holds_head_lock=True)
    leftovers = installation.blobs.prepare()
    if leftovers:
        log.info("interrupted_uploads_removed", files=leftovers)
    keep_compiled_code(settings.data_dir)
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
    painter = ImagePainter(settings.max_image_pixels)
    analyses = AnalysisService(settings, installation.database)
    news = SessionNews(installation.database)
    news.start()
    metrics.watch(installation, runner, analyses)
    maintenance = Maintenance(chores(installation), turn=installation.database.turn)
    maintenance.start()
    key_use = KeyUse(installation.database)
    key_use.start()
    health = HealthWatch(installation, runner)
    report_maker = ReportMaker(installation, analyses)
    report_maker.start()
    delivery = Delivery(installation)
    delivery.start()
    return AppContext(
        installation,
        runner,
        painter,
        analyses,
        metrics,
        head_lock,
        maintenance,
        key_use,
        health,
        news,
        report_maker,
        delivery,
    )


def _stop(service: AppContext) -> None:
    """End every part; one that cannot be ended in order keeps none of the others.

    The runner first: it gives its jobs back while a long chore still hears that it is to stop.
    """
    ends = [
        *([service.runner.stop] if service.runner is not None else []),
        service.maintenance.stop,
        service.news.stop,
        service.report_maker.stop,
        service.delivery.stop,
        service.painter.close,
        service.analyses.close,
        service.key_use.stop,
        service.installation.close,
        service.head_lock.release,
    ]
    for end in ends:
        try:
            end()
        except Exception:
            log.exception("part_not_stopped", part=end.__qualname__)


def _operation_id(route: APIRoute) -> str:
    return route.name
