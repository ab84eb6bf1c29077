"""Every error as an RFC 9457 problem."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from http import HTTPStatus

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse, Response

from app.errors import ContentEncoded, InvalidContent, ServiceError
from app.http import TITLES, ClientDisconnected, invalid_request, status_of

MEDIA_TYPE = "application/problem+json"

CLIENT_LEFT = 499
"""What proxies write into their logs for a client that did not wait for its answer."""

_HTTP_CODES = {
    400: ("invalid_request", "The request cannot be read."),
    404: ("not_found", "There is nothing at this address."),
    405: ("method_not_allowed", "This address does not take this method."),
    413: ("body_too_large", "The body is too large."),
}
_HTTP_ADVICE = {
    404: "See /docs for the addresses there are.",
    405: "The Allow header lists the methods this address takes.",
    413: "Send less at a time.",
}


NEXT_PIECE_WITHIN_S = 60.0
"""How long nothing of a body may come until it counts as one that nobody sends any more."""


def incomplete_body(what: str) -> InvalidContent:
    """Return the refusal of a body that did not come whole: its client fell silent, or went away."""
    return InvalidContent(
        f"The {what} is incomplete: nothing more of it came for {NEXT_PIECE_WITHIN_S:.0f} s, or the connection ended.",
        "Send it again. If it happens again, check the network and the time limits of a proxy in between.",
        code="incomplete_body",
    )


def problem_response(
    status: int,
    code: str,
    detail: str,
    advice: str | None = None,
    errors: Iterable[tuple[str, str]] = (),
    headers: Mapping[str, str] | None = None,
) -> JSONResponse:
    """Return a problem document."""
    return JSONResponse(
        {
            "type": f"urn:gridpose:problem:{code}",
            "title": TITLES.get(status, "Request refused"),
            "status": status,
            "detail": detail,
            "code": code,
            "advice": advice,
            "errors": [{"field": field, "message": message} for field, message in errors],
        },
        status_code=status,
        media_type=MEDIA_TYPE,
        headers=dict(headers) if headers else None,
    )


def service_problem(error: ServiceError) -> JSONResponse:
    """Return the problem of a refusal of ours."""
    status = status_of(error)
    headers = {}
    if status == HTTPStatus.UNAUTHORIZED:
        headers["WWW-Authenticate"] = 'Bearer realm="gridpose"'
    if isinstance(error, ContentEncoded):
        headers["Accept-Encoding"] = "identity"
    if error.retry_after_s is not None:
        headers["Retry-After"] = str(error.retry_after_s)
    return problem_response(status, error.code, error.detail, error.advice, error.errors, headers)


def internal_problem() -> JSONResponse:
    """Return the problem of a defect: nothing of its inside."""
    return problem_response(
        500,
        "internal_error",
        "Something went wrong inside the service.",
        "It is noted in the server's log under this response's X-Request-ID.",
    )


def install_problem_handlers(app: FastAPI) -> None:
    """Make every error this application answers a problem document."""

    async def on_service_error(_request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, ServiceError)
        return service_problem(error)

    async def on_http_error(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, HTTPException)
        code, detail = _HTTP_CODES.get(error.status_code, ("request_refused", "The request was refused."))
        headers = dict(error.headers or {})
        if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
            headers["Allow"] = ", ".join(_allowed_methods(app, request.url.path)) or "GET"
        return problem_response(
            error.status_code, code, detail, _HTTP_ADVICE.get(error.status_code), headers=headers
        )

    async def on_invalid(_request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError)
        return service_problem(invalid_request(error.errors()))

    async def on_client_left(_request: Request, _error: Exception) -> Response:
        return Response(status_code=CLIENT_LEFT)  # for the log and the metrics: nobody reads it

    app.add_exception_handler(ClientDisconnected, on_client_left)
    app.add_exception_handler(ServiceError, on_service_error)
    app.add_exception_handler(HTTPException, on_http_error)
    app.add_exception_handler(RequestValidationError, on_invalid)


def _allowed_methods(app: FastAPI, path: str) -> list[str]:
    """Return every method some route takes at `path`; the router itself names only the first route's."""
    methods: set[str] = set()
    for template, operations in app.openapi()["paths"].items():
        if re.fullmatch(re.sub(r"\{[^}]+\}", "[^/]+", template), path):
            methods.update(method.upper() for method in operations)
            content = operations.get("get", {}).get("responses", {}).get("200", {}).get("content", {})
            if (
                "get" in operations and "text/event-stream" not in content
            ):  # an event stream has no end to await
                methods.add("HEAD")
    return sorted(methods)
