"""What all pages share: who may see them, templates, headers, and errors as pages."""

from __future__ import annotations

import math
from collections.abc import Callable, Coroutine
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode

from fastapi import APIRouter, Request
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from starlette.datastructures import Headers
from starlette.responses import HTMLResponse, RedirectResponse, Response

from app.build import program_version
from app.errors import InvalidContent, NotAuthenticated, ServiceError
from app.http import (
    COOKIE,
    LASTS_S,
    TITLES,
    SignIn,
    authorize,
    begin_sign_in,
    csrf_token,
    holds,
    invalid_request,
    status_of,
)
from app.records.activity import acting
from app.reports.forms import symbols
from app.web import page_words, words
from app.web.service import service_of
from app.web.static_files import static_version

_TEMPLATES = Path(__file__).parent / "templates"
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
    "Referrer-Policy": "same-origin",  # without it, browsers send forms with the origin "null"
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Vary": "HX-Request",
}


class PageRoute(APIRoute):
    """A page: for whoever is signed in and whose key allows the API's operation that `operation_id` names."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        answer = super().get_route_handler()
        operation = self.operation_id
        assert operation is not None, f"{self.name} names no operation"

        async def handle(request: Request) -> Response:
            auth = service_of(request).installation.settings.auth
            if auth == "on" and request.state.key is None:
                return to_sign_in(request)
            try:
                with acting(authorize(request, operation)):
                    response = await answer(request)
            except ServiceError as error:
                return error_page(request, error)
            except RequestValidationError as error:
                return error_page(request, invalid_address(error))
            renew_sign_in(request, response)
            return response

        return handle


def page_router() -> APIRouter:
    """Return a router whose routes are pages, which no OpenAPI document names."""
    return APIRouter(route_class=PageRoute, include_in_schema=False, prefix="/ui")


def render(request: Request, template: str, status: int = 200, **context: Any) -> HTMLResponse:
    """Return a page with what all pages show: who is signed in, what the key allows, the CSRF token."""
    service = service_of(request)
    signed_in: SignIn | None = getattr(request.state, "sign_in", None)
    auth = service.installation.settings.auth
    shown = {
        "key": getattr(request.state, "key", None),
        "auth": auth,
        "csrf": csrf_token(service.installation, signed_in.nonce) if signed_in is not None else "",
        "may": lambda scope: holds(request, scope),
        "path": request.url.path,
        "version": program_version(),
        "static": static_version(),
        **context,
    }
    text = environment().get_template(template).render(shown)
    return HTMLResponse(text, status_code=status, headers=_HEADERS)


def is_fragment(request: Request) -> bool:
    """Return whether a script asks for a part of a page, to put it in place."""
    return asks_for_fragment(request.headers)


def asks_for_fragment(headers: Headers) -> bool:
    """Return whether headers say that a script of a page asks."""
    return headers.get("hx-request") == "true" and "hx-history-restore-request" not in headers


def to_sign_in(request: Request) -> Response:
    """Lead to the sign-in page, and from there back to this one."""
    query = f"?{request.url.query}" if request.url.query else ""
    came_from = request.url.path + query if request.method == "GET" else "/ui/"
    asked = {"next": came_from}
    if COOKIE in request.cookies:
        asked["ended"] = (
            "1"  # it was signed in, with a key that is expired or revoked by now, or too long ago
        )
    address = f"/ui/sign-in?{urlencode(asked)}"
    if is_fragment(request):
        return Response(status_code=401, headers={**_HEADERS, "HX-Redirect": "/ui/sign-in?ended=1"})
    return RedirectResponse(address, status_code=303, headers=_HEADERS)


def renew_sign_in(request: Request, response: Response) -> None:
    """Give the sign-in that is in use a later end."""
    signed_in: SignIn | None = request.state.sign_in
    if signed_in is not None and signed_in.wants_renewal:
        installation = service_of(request).installation
        set_sign_in(request, response, begin_sign_in(installation, signed_in.key, signed_in.nonce))


def set_sign_in(request: Request, response: Response, value: str) -> None:
    """Put a sign-in into the browser's cookie, which neither scripts nor pages of other sites can use."""
    response.set_cookie(
        COOKIE,
        value,
        max_age=LASTS_S,
        path="/",
        httponly=True,
        samesite="strict",
        secure=came_by_tls(request),
    )


def came_by_tls(request: Request) -> bool:
    """Return whether the browser reached us by TLS, here or at a proxy; a false claim harms its sender alone."""
    return "https" in (request.url.scheme, request.headers.get("x-forwarded-proto", "").lower())


def error_page(request: Request, error: ServiceError) -> Response:
    """Return a refusal as a page: what happened and what to do."""
    if isinstance(error, NotAuthenticated):
        return to_sign_in(request)
    status = int(status_of(error))
    template = "_refusal.html" if is_fragment(request) else "error.html"
    title = TITLES.get(status, "Refused")
    response = render(request, template, status, title=title, status_code=status, error=error)
    if error.retry_after_s is not None:
        response.headers["Retry-After"] = str(error.retry_after_s)
    return response


def invalid_address(error: RequestValidationError) -> InvalidContent:
    """Return the refusal of an address whose query cannot be read."""
    return InvalidContent(
        "Some values are not valid.",
        "Correct them, or begin anew from the list of sessions.",
        errors=invalid_request(error.errors()).errors,
    )


@cache
def environment() -> Environment:
    """Return the templates; text of users is escaped wherever it stands."""
    made = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters.update(
        number=words.number,
        fixed=words.fixed,
        plain=words.plain,
        interval=words.interval,
        moment=words.moment,
        machine_moment=words.machine_moment,
        size=words.size,
        grouped=words.grouped,
        words=words.words,
        linked=page_words.linked,
        coded=page_words.coded,
        on_pages=page_words.on_pages,
        named=page_words.named,
        symbols=symbols,
        quoted=lambda text: quote(str(text), safe=""),
    )
    made.globals.update(
        state_of=words.state_of,
        legend_of=words.legend_of,
        with_uncertainty=words.with_uncertainty,
        length_with_uncertainty=words.length_with_uncertainty,
        rounded_by=words.rounded_by,
        rounded_by_interval=words.rounded_by_interval,
        shown_change=words.shown_change,
        plural=words.plural,
        verdicts=words.VERDICTS,
        decisions=words.DECISIONS,
        no_cycles=words.NO_CYCLES,
        estimators=words.ESTIMATORS,
        report_states=words.REPORT_STATES,
        report_kinds=words.REPORT_KINDS,
        report_forms=words.REPORT_FORMS,
        scopes=words.SCOPES,
        next_page=page_words.next_page_here,
        list_of=page_words.list_of,
        missing=page_words.MISSING,
        view_purposes=words.VIEW_PURPOSES,
        methods=words.METHODS,
        lens_models=words.LENS_MODELS,
        query=query_of,
        sqrt=math.sqrt,
    )
    return made


def query_of(values: dict[str, Any], **changes: Any) -> str:
    """Return the query of an address: the values with changes, those that are empty gone."""
    merged = {name: value for name, value in {**values, **changes}.items() if value not in (None, "", False)}
    return f"?{urlencode(merged)}" if merged else "?"
