"""Who may do what: a key in the Authorization header, before anything else of a request is looked at."""

from __future__ import annotations

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from app.api.contract import Service
from app.api.problems import service_problem
from app.errors import NotAllowed, NotAuthenticated, ServiceError
from app.services.keys import find_key

PUBLIC = ("/livez", "/readyz", "/openapi.json", "/docs")
PUBLIC_FOLDER = "/docs/"
_RANK = {"read": 0, "upload": 1, "admin": 2}


def required_scope(method: str, path: str) -> str:
    """Return the least scope that may send `method` to `path`."""
    if path == "/v1/keys" or path.startswith("/v1/keys/") or method in ("PATCH", "DELETE"):
        return "admin"
    return "upload" if method in ("POST", "PUT") else "read"


class KeyCheck:
    """Refuses requests without a valid key (401) or with one whose scope does not suffice (403)."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            path: str = scope["path"]
            if path not in PUBLIC and not path.startswith(PUBLIC_FOLDER):
                service: Service = scope["app"].state.service
                try:
                    if service.installation.settings.auth == "on":
                        await _check(service, scope["method"], path, Headers(scope=scope))
                except ServiceError as error:
                    await service_problem(error)(scope, receive, send)
                    return
        await self._app(scope, receive, send)


async def _check(service: Service, method: str, path: str, headers: Headers) -> None:
    kind, _, credentials = headers.get("authorization", "").partition(" ")
    credentials = credentials.strip()
    if kind.lower() != "bearer" or not credentials:
        raise NotAuthenticated("This address needs an API key.", "Send it as `Authorization: Bearer KEY`.")
    key = await run_in_threadpool(find_key, service.installation, credentials)
    if key is None:
        raise NotAuthenticated(
            "The API key is not valid.", "Check that it is complete, not expired and not revoked."
        )
    needed = required_scope(method, path)
    if _RANK[key.scope] < _RANK[needed]:
        raise NotAllowed(
            f"The API key's scope is {key.scope}; this needs {needed}.",
            f"Use a key made with the scope {needed}.",
        )
