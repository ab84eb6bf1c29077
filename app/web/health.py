"""Whether the service is well, as every page that says so finds it: its parts, and what `gridpose doctor` finds."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import sqlalchemy as sa
from fastapi import Request
from sqlalchemy import orm
from starlette.concurrency import run_in_threadpool

from app.records.tables import Measurement
from app.services.health import Check
from app.services.inspection import CheckResult, State, inspect_quickly
from app.web.service import Service, service_of
from app.web.words import plural

TAKEN_WITHIN = timedelta(seconds=15.0)
"""A worker takes an image that waits sooner than that, unless it computes others."""


@dataclass(frozen=True, slots=True)
class Health:
    """The state of every part, and what was found of the installation, by subject; `idle` is how many images wait while
    nothing computes any.
    """

    checks: list[Check]
    inspected: dict[str, list[CheckResult]]
    idle: int = 0

    @property
    def kind(self) -> str:
        """The worst of all that was found: `bad`, `fair` or `good`."""
        states = {one.state for part in self.inspected.values() for one in part}
        if not all(check.ok for check in self.checks) or State.failed in states:
            return "bad"
        return "fair" if self.idle or State.warning in states else "good"

    @property
    def sentence(self) -> str:
        """What it comes to."""
        failing = [check.detail for check in self.checks if not check.ok]
        if self.kind == "bad":
            return " ".join(["The service cannot do all its work.", *failing])
        if self.kind == "good":
            return "All is well."
        if self.idle:
            return no_worker(self.idle)
        count = sum(one.state != State.ok for part in self.inspected.values() for one in part)
        return (
            f"Every part does its work; {plural(count, 'point')} {'needs' if count == 1 else 'need'} a look."
        )


async def look(request: Request) -> Health:
    """Look at every part and at the installation."""
    service = service_of(request)
    checks, inspected, idle = await asyncio.gather(
        service.health.look(),
        run_in_threadpool(inspect_quickly, service.installation.settings),
        run_in_threadpool(_read_idle, service),
    )
    return Health(checks, inspected, idle)


def count_idle(service: Service, records: orm.Session) -> int:
    """Return how many images wait for a worker where nothing computes any: not this process, and no other one."""
    if service.runner is not None:
        return 0
    running = sa.exists().where(Measurement.status == "running")
    waiting = sa.select(sa.func.count(), sa.func.min(Measurement.received_at)).where(
        Measurement.status == "queued", ~running
    )
    count, first = records.execute(waiting).one()
    return count if count and datetime.now(UTC) - first > TAKEN_WITHIN else 0


def _read_idle(service: Service) -> int:
    with service.installation.database.read() as records:
        return count_idle(service, records)


def no_worker(idle: int) -> str:
    """Return what is to be done where images wait and nothing computes them."""
    return (
        f"{plural(idle, 'image')} {'waits' if idle == 1 else 'wait'}, and no worker computes "
        f"{'it' if idle == 1 else 'them'}. Start one on the server: `gridpose worker`."
    )
