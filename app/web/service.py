"""The parts of the running application that pages draw on."""

from __future__ import annotations

from typing import Protocol, cast

from fastapi import Request

from app.analyses.service import AnalysisService
from app.jobs.runner import JobRunner
from app.services.health import HealthWatch
from app.services.installation.context import ServiceContext


class Service(Protocol):
    """What `app.main` starts, as far as pages need it."""

    installation: ServiceContext
    analyses: AnalysisService
    health: HealthWatch
    runner: JobRunner | None


def service_of(request: Request) -> Service:
    """Return the application's parts."""
    return cast("Service", request.app.state.service)
