"""What every route shares: the order of errors, strict bodies, documented problems, and access to the service."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, get_args, get_origin

import structlog
from fastapi import APIRouter, Depends, Query, Request
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from app.api.metrics import Metrics
from app.api.problems import MEDIA_TYPE
from app.api.schemas.common import PlainInt
from app.api.strict_json import MIB, parse, read_body, require_json
from app.errors import InvalidContent, NotFound
from app.jobs.embedded import EmbeddedRunner
from app.jobs.overlay import OverlayPainter
from app.records.lock import FileLock
from app.records.tables import Measurement, Robot, Session, Table, Target
from app.services.analyses.desk import AnalysisDesk
from app.services.installation import Installation
from app.services.lookup import NOUNS, exists

log = structlog.get_logger(__name__)

BODY_LIMIT = MIB
BULK_LIMIT = 16 * MIB
_PROBLEM_REFERENCE = {"content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}}
_DESCRIPTIONS = {
    401: "No valid key was sent.",
    403: "The key's scope does not allow this.",
    404: "There is no such resource.",
    409: "The state of the resource does not allow this now.",
    413: "The body is too large.",
    415: "The body's media type or image format is not taken here.",
    422: "The content is not valid.",
    503: "The service cannot do this just now.",
    507: "There is no room to store this.",
}
_PARENTS: dict[str, type[Table]] = {
    "target_id": Target,
    "robot_id": Robot,
    "session_id": Session,
    "measurement_id": Measurement,
}


@dataclass(slots=True)
class Service:
    """What the routes of one application work with."""

    installation: Installation
    runner: EmbeddedRunner | None
    painter: OverlayPainter
    analyses: AnalysisDesk
    metrics: Metrics
    head_lock: FileLock
    stopping: bool = field(default=False)

    def begin_shutdown(self) -> None:
        """Note that the process is told to end: streams end, no job is taken, lost workers count no attempt."""
        self.stopping = True
        self.analyses.begin_shutdown()
        if self.runner is not None:
            self.runner.begin_stop()


async def get_service(request: Request) -> Service:
    """Return the application's service; a coroutine, so that no thread is spent on it."""
    service = request.app.state.service
    assert isinstance(service, Service)
    return service


ServiceDep = Annotated[Service, Depends(get_service)]
Limit = Annotated[PlainInt, Query(ge=1, le=500, description="Items of one page.")]
Cursor = Annotated[
    str | None, Query(min_length=1, max_length=200, description="`next_cursor` of the page before.")
]


class ContractRoute(APIRoute):
    """A route that looks at the address first (404), then at the body: media type, size, JSON, fields."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        answer = super().get_route_handler()
        takes_json = self.body_field is not None
        limit = BULK_LIMIT if "bulk" in self.tags else BODY_LIMIT
        # An analysis whose settings were misspelt would be another one than was asked for.
        parameters = _query_parameters(self.dependant)
        strict = "analyses" in self.tags

        async def handle(request: Request) -> Response:
            await _find_parents(request)
            if strict:
                _refuse_unknown_parameters(request, parameters)
            if takes_json:
                require_json(request)
                body = await read_body(request, limit)
                # Starlette keeps both under these names; FastAPI then takes them as read.
                request._body = body
                request._json = parse(body)
            return await answer(request)

        return handle


def _query_parameters(dependant: Dependant) -> dict[str, bool]:
    """Return the names of a route's query parameters, those of what it depends on too, and which may be repeated."""
    found = {field.alias: _is_list(field.field_info.annotation) for field in dependant.query_params}
    for each in dependant.dependencies:
        found |= _query_parameters(each)
    return found


def _is_list(annotation: Any) -> bool:
    return get_origin(annotation) is list or any(map(_is_list, get_args(annotation)))


def _refuse_unknown_parameters(request: Request, parameters: Mapping[str, bool]) -> None:
    """Raise InvalidContent for query parameters that mean nothing here, and for single ones given twice."""
    names = [name for name, _ in request.query_params.multi_items()]
    known = set(parameters)
    twice = sorted({name for name in names if names.count(name) > 1 and not parameters.get(name, True)})
    if twice:
        raise InvalidContent(
            "The address gives a query parameter more than once.",
            "Give each parameter once.",
            errors=[(name, "is given more than once") for name in twice],
        )
    unknown = sorted(set(names) - known)
    if unknown:
        raise InvalidContent(
            "The address holds query parameters that are not known.",
            f"Check their spelling; known are {', '.join(sorted(known))}."
            if known
            else "This address takes none.",
            errors=[(name[:200], "is not known") for name in unknown[:20]],
        )


async def _find_parents(request: Request) -> None:
    """Raise NotFound for an id in the address that names nothing."""
    named = [
        (table, request.path_params[name]) for name, table in _PARENTS.items() if name in request.path_params
    ]
    if named:
        service = await get_service(request)
        await run_in_threadpool(_check_existence, service.installation, named)


def _check_existence(installation: Installation, named: list[tuple[type[Table], str]]) -> None:
    with installation.database.read() as records:
        for table, row_id in named:
            if not exists(records, table, row_id):
                raise NotFound.of(NOUNS[table])


def contract_router(**settings: Any) -> APIRouter:
    """Return a router whose routes keep the contract."""
    return APIRouter(route_class=ContractRoute, **settings)


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the documentation of the problems a route may answer with; 401 and 403 go without saying."""
    return {
        status: {"description": _DESCRIPTIONS[status], **_PROBLEM_REFERENCE}
        for status in sorted({401, 403, *statuses})
    }
