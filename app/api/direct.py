"""Routes that every image takes, without the framework's machinery around them.

A direct route is declared and documented like any other: its function's signature is the contract. It is found by its
own address before the router looks through all, its parameters are read by the fields that the framework made of the
signature, and its function makes the response itself. That saves half of what the framework spends on a request.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Coroutine, Sequence
from typing import Any

from fastapi import Request
from fastapi.dependencies.models import Dependant
from starlette.responses import Response
from starlette.routing import BaseRoute, Match
from starlette.types import ASGIApp, Receive, Scope, Send

from app.api.dependencies import get_app_context
from app.api.problems import service_problem
from app.api.routing import StrictRoute, check_parameters, find_parents, query_parameters
from app.errors import ServiceError
from app.http import authorize, check_headers, invalid_request
from app.records.activity import acting

Handler = Callable[[Request], Coroutine[Any, Any, Response]]


class DirectRoute(StrictRoute):
    """A route whose function takes path, query, request and service alone, and returns the response."""

    def get_route_handler(self) -> Handler:
        answer = self.dependant.call
        assert answer is not None
        assert self.body_field is None
        parameters, known = _Parameters(self.dependant), query_parameters(self.dependant)
        operation = self.name

        async def handle(request: Request) -> Response:
            with acting(authorize(request, operation)):
                await find_parents(request)
                check_headers(request.method, request.headers)
                if request.scope["query_string"]:
                    check_parameters(request, known)
                response: Response = await answer(**parameters.read(request))
                return response

        self.direct = handle
        return handle


class DirectRoutes:
    """Hands requests of direct routes to them; all others go on to the router."""

    def __init__(self, app: ASGIApp, routes: Collection[BaseRoute]) -> None:
        self._app = app
        self._routes = [route for route in routes if isinstance(route, DirectRoute)]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            for route in self._routes:
                if scope["method"] not in (route.methods or ()):
                    continue
                match, found = route.matches(scope)
                if match is Match.FULL:
                    scope.update(found)
                    await _answer(route.direct, scope, receive, send)
                    return
        await self._app(scope, receive, send)


async def _answer(handle: Handler, scope: Scope, receive: Receive, send: Send) -> None:
    try:
        response = await handle(Request(scope, receive, send))
    except ServiceError as error:
        response = service_problem(error)
    await response(scope, receive, send)


class _Parameters:
    """What a function takes of a request, read and checked as its signature says."""

    def __init__(self, dependant: Dependant) -> None:
        assert all(each.call is get_app_context for each in dependant.dependencies)
        assert not dependant.header_params
        assert not dependant.cookie_params
        self._path, self._query = dependant.path_params, dependant.query_params
        self._defaults = {field.name: field.get_default() for field in self._query}
        self._services: Sequence[str] = [
            each.name for each in dependant.dependencies if each.name is not None
        ]
        self._request = dependant.request_param_name

    def read(self, request: Request) -> dict[str, Any]:
        """Return the function's arguments. Raises InvalidContent that names every wrong one."""
        values: dict[str, Any] = dict(self._defaults)
        errors: list[Any] = []
        for field in self._path:
            values[field.name], wrong = field.validate(
                request.path_params[field.alias], loc=("path", field.alias)
            )
            errors += wrong
        if request.scope["query_string"]:
            sent = request.query_params
            for field in self._query:
                if field.alias in sent:
                    values[field.name], wrong = field.validate(sent[field.alias], loc=("query", field.alias))
                    errors += wrong
        if errors:
            raise invalid_request(errors)
        for name in self._services:
            values[name] = request.app.state.service
        if self._request is not None:
            values[self._request] = request
        return values
