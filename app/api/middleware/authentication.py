"""The key of a request: in the Authorization header, or by the cookie of a dashboard's sign-in.

`ApiKeyAuth` finds the key before anything else of a request is examined, and leaves it in `request.state.key`, None
with GRIDPOSE_AUTH=off. What a key may do is `app.http.authorize`'s.
"""

from __future__ import annotations

import hmac

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import cookie_parser
from starlette.types import ASGIApp, Receive, Scope, Send

from app.api.problems import service_problem
from app.errors import NotAllowed, NotAuthenticated, ServiceError
from app.http import COOKIE, CSRF_HEADER, SignIn, csrf_token, read_sign_in
from app.logs import Logger
from app.records.tables import ApiKey
from app.services.installation.context import ServiceContext
from app.services.keys import find_key, recall_key

PUBLIC = ("/", "/livez", "/readyz", "/openapi.json", "/docs")
PUBLIC_FOLDER = "/docs/"
DETAILED_WITH_KEY = ("/readyz",)
"""Public addresses that say more to those who have a key."""
DASHBOARD = "/ui"
"""Pages lead who is not signed in to the sign-in page, and look at the key themselves."""
_SAFE = ("GET", "HEAD", "OPTIONS")

log = Logger(__name__)


class ApiKeyAuth:
    """Refuses requests without a valid key (401)."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            state = scope.setdefault("state", {})
            state["key"] = state["sign_in"] = None
            path: str = scope["path"]
            service = scope["app"].state.service
            asks_for_key = service.installation.settings.auth == "on"
            if asks_for_key and (path == DASHBOARD or path.startswith(f"{DASHBOARD}/")):
                signed_in = await _signed_in(service.installation, Headers(scope=scope))
                if signed_in is not None:
                    service.key_use.note(signed_in.key.id)
                    state["key"], state["sign_in"] = signed_in.key, signed_in
            elif asks_for_key and path not in PUBLIC and not path.startswith(PUBLIC_FOLDER):
                try:
                    key = await _authenticate(service.installation, Headers(scope=scope), scope["method"])
                except ServiceError as error:
                    if isinstance(error, NotAuthenticated):
                        log.warning("authentication_failed", client=state.get("client"))
                    await service_problem(error)(scope, receive, send)
                    return
                service.key_use.note(key.id)
                state["key"] = key
            elif asks_for_key and path in DETAILED_WITH_KEY:
                state["key"] = await _key_if_valid(service.installation, Headers(scope=scope))
        await self._app(scope, receive, send)


async def _key_if_valid(installation: ServiceContext, headers: Headers) -> ApiKey | None:
    """Return the key of a request that needs none; one that is not valid is as good as none."""
    try:
        return await _authenticate(installation, headers, "GET")
    except ServiceError:  # without the database, or without a key, the address answers all the same
        return None


async def _signed_in(installation: ServiceContext, headers: Headers) -> SignIn | None:
    """Return the dashboard's sign-in that a request's cookie names, None without a valid one."""
    cookie = cookie_parser(headers.get("cookie", "")).get(COOKIE)
    return None if not cookie else await run_in_threadpool(read_sign_in, installation, cookie)


async def _authenticate(installation: ServiceContext, headers: Headers, method: str) -> ApiKey:
    """Return the valid key of a request; raise NotAuthenticated if the request has no valid key.

    A browser that is signed in sends its cookie on its own; so a request that changes something must carry the CSRF
    token, too, which no page of another origin can know. Raises NotAllowed where it does not.
    """
    if "authorization" not in headers:
        signed_in = await _signed_in(installation, headers)
        if signed_in is not None:
            expected = csrf_token(installation, signed_in.nonce)
            sent = headers.get(CSRF_HEADER, "")
            if method not in _SAFE and not hmac.compare_digest(sent.encode(), expected.encode()):
                raise NotAllowed(
                    "The request does not carry the token of the page that it comes from.",
                    "Load the page again and repeat this. Programs send their key as `Authorization: Bearer KEY`.",
                    code="csrf_token_invalid",
                )
            return signed_in.key
    kind, _, credentials = headers.get("authorization", "").partition(" ")
    credentials = credentials.strip()
    if kind.lower() != "bearer" or not credentials:
        raise NotAuthenticated("This address needs an API key.", "Send it as `Authorization: Bearer KEY`.")
    key = recall_key(installation, credentials)
    if key is None:
        key = await run_in_threadpool(find_key, installation, credentials)
    if key is None:
        raise NotAuthenticated(
            "The API key is not valid.", "Check that it is complete, not expired and not revoked."
        )
    return key
