"""Routes that keep the contract: the order of errors, strict bodies, documented problems."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping
from typing import Any, get_args, get_origin

from fastapi import APIRouter, Request
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from app.api.dependencies import get_app_context
from app.api.json_body import (
    INLINE_LIMIT,
    MIB,
    BodyReader,
    arriving,
    collector_off,
    parse,
    read_body,
    require_json,
    stated_length,
    stated_media_type,
)
from app.api.problems import MEDIA_TYPE
from app.api.representations import CSV, LIST_CSV, is_page, page_in_form, read_csv_list
from app.errors import InvalidContent, NotFound
from app.http import UNSAFE, authorize, check_headers, get_requester
from app.records.activity import acting
from app.records.tables import Measurement, Qualification, Report, Robot, Session, Table, Target, Webhook
from app.services.installation.context import ServiceContext
from app.services.measurements import recall_targets, session_targets
from app.services.queries import NOUNS, exists

BODY_LIMIT = MIB
BULK_LIMIT = 16 * MIB
TAKE_CSV = frozenset({"put_poses", "put_measured_poses"})
"""Operations whose list may be sent as a CSV table."""
_MAKING = (201, 202)
_LOCATION = {
    "headers": {
        "Location": {
            "description": "Path of what was made, or of where its progress is read.",
            "schema": {"type": "string"},
        }
    }
}
_PROBLEM_REFERENCE = {"content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}}
_RETRY_LATER = {
    "headers": {
        "Retry-After": {
            "description": "Where it is known: seconds after which the request may succeed.",
            "schema": {"type": "integer", "minimum": 0},
        }
    }
}
_DESCRIPTIONS = {
    401: "No valid key was sent.",
    403: "The key's scope does not allow this.",
    404: "There is no such resource.",
    409: "The state of the resource does not allow this now.",
    412: "The request has an If-Match other than `*`; nothing that can be changed has an entity tag.",
    413: "The body is too large.",
    415: "The body's media type or image format is not taken here.",
    422: "The content is not valid.",
    429: "The key has sent what its quota allows in a day.",
    500: "A defect of the service, noted in its log.",
    503: "The service cannot do this just now.",
    507: "There is no room to store this.",
}
CSV_BODY = {
    "requestBody": {
        "content": {
            CSV: {
                "schema": {
                    "type": "string",
                    "description": "A table (RFC 4180, UTF-8) whose header has the names of the JSON list's fields, or "
                    "`x_mm`, `y_mm`, `z_mm`, `j1_deg`, `j2_deg`, ...; with semicolons, numbers may have decimal "
                    "commas.",
                }
            }
        }
    }
}
"""That an operation takes its list as CSV, too."""
_PARENTS: dict[str, type[Table]] = {
    "target_id": Target,
    "robot_id": Robot,
    "session_id": Session,
    "measurement_id": Measurement,
    "report_id": Report,
    "other_report_id": Report,
    "qualification_id": Qualification,
    "webhook_id": Webhook,
}


class StrictRoute(APIRoute):
    """A route that looks at the key's scope first (403), then at the address (404), then at the body.

    Of the body at the media type, the size, the JSON and the fields, in this order. A page of a list is JSON or CSV.
    """

    def __init__(self, path: str, endpoint: Callable[..., Any], **settings: Any) -> None:
        super().__init__(path, endpoint, **settings)
        for status in _MAKING:
            if status == self.status_code or status in self.responses:
                self.responses = {**self.responses, status: {**_LOCATION, **self.responses.get(status, {})}}
        if not UNSAFE.isdisjoint(self.methods or ()):
            self.responses = {**self.responses, 412: problem_responses(412)[412]}
        if self._is_list:
            self.responses = {**self.responses, 200: {**LIST_CSV, **self.responses.get(200, {})}}

    @property
    def _is_list(self) -> bool:
        return self.methods == {"GET"} and is_page(self.response_model)

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        answer = super().get_route_handler()
        limit = BULK_LIMIT if "bulk" in self.tags else BODY_LIMIT
        # A misspelt filter or setting would be lost, and the answer another one than was asked for.
        parameters = query_parameters(self.dependant)
        operation = self.name
        reader = BodyReader(self.body_field.field_info) if self.body_field is not None else None
        is_required = self.body_field is not None and self.body_field.field_info.is_required()
        page = self.response_model if self._is_list else None

        async def handle(request: Request) -> Response:
            with acting(authorize(request, operation)):
                return await handle_allowed(request)

        async def handle_allowed(request: Request) -> Response:
            await find_parents(request)
            check_headers(request.method, request.headers)
            if request.scope["query_string"]:
                check_parameters(request, parameters)
            if page is not None:
                return await page_in_form(request, page, await answer(request))
            if reader is None:
                return await answer(request)
            if operation in TAKE_CSV and stated_media_type(request) == CSV:
                return await answer(await _from_csv(request, reader, limit))
            if not is_required and not _has_body(request):
                return await answer(request)
            require_json(request, takes_csv=operation in TAKE_CSV)
            stated = stated_length(request, limit)
            # Starlette keeps the body under these names; FastAPI then takes it as read.
            if stated is not None and stated <= INLINE_LIMIT:
                request._body = await read_body(request, limit)
                request._json = parse(request._body)
                return await answer(request)
            service = await get_app_context(request)
            async with service.body_places.taken(await get_requester(request)):
                async with arriving():
                    request._body = await read_body(request, limit)
                if len(request._body) <= INLINE_LIMIT:
                    request._json = parse(request._body)
                    return await answer(request)
                async with service.large_bodies, collector_off():
                    request._json = await run_in_threadpool(reader.read, request._body)
                    return await answer(request)

        return handle


def _has_body(request: Request) -> bool:
    """Return whether a request says that it has a body (RFC 9112, 6.3), or of what kind it is."""
    headers = request.headers
    return (
        headers.get("content-length", "0") != "0"
        or "transfer-encoding" in headers
        or "content-type" in headers
    )


async def _from_csv(request: Request, reader: BodyReader, limit: int) -> Request:
    """Return a request whose body, a CSV table, is read as the JSON list that it stands for."""
    service = await get_app_context(request)
    async with service.body_places.taken(await get_requester(request)):
        async with arriving():
            body = await read_body(request, limit)
        async with service.large_bodies, collector_off():
            items = await run_in_threadpool(lambda: reader.validated(read_csv_list(body)))
    headers = [(name, value) for name, value in request.scope["headers"] if name != b"content-type"]
    headers.append((b"content-type", b"application/json"))  # by which the framework looks for `_json`
    found = Request({**request.scope, "headers": headers}, request.receive)
    found._body, found._json = body, items
    return found


def query_parameters(dependant: Dependant) -> dict[str, bool]:
    """Return the names of a route's query parameters, those of what it depends on too, and which may be repeated."""
    found = {field.alias: _is_list(field.field_info.annotation) for field in dependant.query_params}
    for each in dependant.dependencies:
        found |= query_parameters(each)
    return found


def _is_list(annotation: Any) -> bool:
    return get_origin(annotation) is list or any(map(_is_list, get_args(annotation)))


def check_parameters(request: Request, parameters: Mapping[str, bool]) -> None:
    """Raise InvalidContent for query parameters that the route does not have, and for single ones given twice."""
    names = [name for name, _ in request.query_params.multi_items()]
    twice = sorted({name for name in names if names.count(name) > 1 and not parameters.get(name, True)})
    if twice:
        raise InvalidContent(
            "The address gives a query parameter more than once.",
            "Give each parameter once.",
            errors=[(name, "is given more than once") for name in twice],
        )
    unknown = sorted(set(names) - set(parameters))
    if unknown:
        raise InvalidContent(
            "The address holds query parameters that are not known.",
            f"Check their spelling; known are {', '.join(sorted(parameters))}."
            if parameters
            else "This address takes none.",
            errors=[(name[:200], "is not known") for name in unknown[:20]],
        )


async def find_parents(request: Request) -> None:
    """Raise NotFound for an id in the address that names nothing; of a session's own, keep `request.state.targets`."""
    named = [
        (table, request.path_params[name]) for name, table in _PARENTS.items() if name in request.path_params
    ]
    if named:
        service = await get_app_context(request)
        if [table for table, _ in named] == [Session]:
            targets = recall_targets(service.installation, named[0][1])
            if targets is None:  # a thread asks the database
                targets = await run_in_threadpool(session_targets, service.installation, named[0][1])
            request.state.targets = targets
            return
        await run_in_threadpool(_check_existence, service.installation, named)


def _check_existence(installation: ServiceContext, named: list[tuple[type[Table], str]]) -> None:
    with installation.database.read() as records:
        for table, row_id in named:
            if not exists(records, table, row_id):
                raise NotFound.of(NOUNS[table])


def api_router(**settings: Any) -> APIRouter:
    """Return a router whose routes keep the contract."""
    return APIRouter(route_class=StrictRoute, **settings)


def problem_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the documentation of the problems a route may answer with; those of any route go without saying."""
    return {
        status: {
            "description": _DESCRIPTIONS[status],
            **(_RETRY_LATER if status in (429, 503, 507) else {}),
            **_PROBLEM_REFERENCE,
        }
        for status in sorted({401, 403, 422, 500, 503, *statuses})
    }
