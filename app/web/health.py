"""Whether the service is well, as every page that says so finds it: its parts, and what `gridpose doctor` finds."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from fastapi import Request
from starlette.concurrency import run_in_threadpool

from app.services.health import Check
from app.services.inspection import CheckResult, State, inspect_quickly
from app.web.service import service_of
from app.web.words import plural


@dataclass(frozen=True, slots=True)
class Health:
    """The state of every part, and what was found of the installation, by subject."""

    checks: list[Check]
    inspected: dict[str, list[CheckResult]]

    @property
    def kind(self) -> str:
        """The worst of all that was found: `bad`, `fair` or `good`."""
        states = {one.state for part in self.inspected.values() for one in part}
        if not all(check.ok for check in self.checks) or State.failed in states:
            return "bad"
        return "fair" if State.warning in states else "good"

    @property
    def sentence(self) -> str:
        """What it comes to."""
        failing = [check.detail for check in self.checks if not check.ok]
        if self.kind == "bad":
            return " ".join(["The service cannot do all its work.", *failing])
        if self.kind == "good":
            return "All is well."
        count = sum(one.state != State.ok for part in self.inspected.values() for one in part)
        return (
            f"Every part does its work; {plural(count, 'point')} {'needs' if count == 1 else 'need'} a look."
        )


async def look(request: Request) -> Health:
    """Look at every part and at the installation."""
    service = service_of(request)
    checks, inspected = await asyncio.gather(
        service.health.look(), run_in_threadpool(inspect_quickly, service.installation.settings)
    )
    return Health(checks, inspected)
