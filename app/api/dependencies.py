"""Dependencies of routes: the parts of the application, and the parameters of pages."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Annotated

from fastapi import Depends, Path, Query, Request
from pydantic import Field

from app.analyses.reporting import ReportMaker
from app.analyses.service import AnalysisService
from app.api.event_streams import EventStreams
from app.api.json_body import BodyPlaces
from app.api.metrics import Metrics
from app.api.schemas.common import PlainDigits, PoseTag, Text
from app.api.schemas.fields import POSE_ID
from app.delivery import Delivery
from app.jobs.painting import ImagePainter
from app.jobs.runner import JobRunner
from app.records.file_lock import FileLock
from app.services.following import SessionNews
from app.services.health import HealthWatch
from app.services.installation.context import ServiceContext
from app.services.keys import KeyUse
from app.services.maintenance.chores import Maintenance


@dataclass(slots=True)
class AppContext:
    """What the routes of one application work with."""

    installation: ServiceContext
    runner: JobRunner | None
    painter: ImagePainter
    analyses: AnalysisService
    metrics: Metrics
    head_lock: FileLock
    maintenance: Maintenance
    key_use: KeyUse
    health: HealthWatch
    news: SessionNews
    report_maker: ReportMaker
    delivery: Delivery
    streams: EventStreams = field(default_factory=EventStreams)
    body_places: BodyPlaces = field(default_factory=BodyPlaces)
    stopping: bool = field(default=False)
    large_bodies: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(1))
    """One at a time: together they would keep the interpreter's lock from the event loop."""

    def begin_shutdown(self) -> None:
        """Begin to stop: streams end, no job is taken, and lost workers count no attempt."""
        self.stopping = True
        self.installation.database.patience.end_within()
        self.news.wake_all()
        self.report_maker.begin_stop()
        self.delivery.begin_stop()
        self.analyses.begin_shutdown()
        self.maintenance.begin_stop()
        if self.runner is not None:
            self.runner.begin_stop()


async def get_app_context(request: Request) -> AppContext:
    """Return the application's parts; a coroutine, so that no thread is spent on it."""
    service = request.app.state.service
    assert isinstance(service, AppContext)
    return service


AppContextDep = Annotated[AppContext, Depends(get_app_context)]
Limit = Annotated[
    int,
    Field(ge=1, le=500),
    PlainDigits,
    Query(description="Items of one page at most; 50 by default."),
]
Cursor = Annotated[
    str | None,
    Query(
        min_length=1,
        max_length=200,
        description="`next_cursor` of the page before; without it, the first page.",
    ),
]
NameFilter = Annotated[Text | None, Query(description="Those that have exactly this name.")]
AcceptImplausible = Annotated[
    bool, Query(description="`true`: store values that look like another unit, too (`implausible_unit`).")
]
TargetPath = Annotated[str, Path(description="Id of a target, as lists and answers show it.")]
RobotPath = Annotated[str, Path(description="Id of a robot, as lists and answers show it.")]
EventPath = Annotated[str, Path(description="Id of a robot's event, as the list of its events shows it.")]
SessionPath = Annotated[str, Path(description="Id of a session, as lists and answers show it.")]
ReportPath = Annotated[str, Path(description="Id of a report, as lists and answers show it.")]
MeasurementPath = Annotated[str, Path(description="Id of a measurement, as lists and answers show it.")]
WebhookPath = Annotated[str, Path(description="Id of a webhook, as the list of webhooks shows it.")]
DeliveryPath = Annotated[str, Path(description="Id of a delivery, as the webhook's journal shows it.")]
KeyPath = Annotated[str, Path(description="Id of an API key, as the list of keys shows it; not the secret.")]
PosePath = Annotated[PoseTag, Path(description=POSE_ID)]
