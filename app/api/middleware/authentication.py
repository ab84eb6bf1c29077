"""Who may do what: a key in the Authorization header first (401), then what its scope and limits allow (403).

`ApiKeyAuth` finds the key before anything else of a request is examined, and leaves it in `request.state.key`, None
with GRIDPOSE_AUTH=off. Every route of `api_router` calls `authorize` before it examines address and body.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

import structlog
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from app.api.problems import service_problem
from app.errors import NotAllowed, NotAuthenticated, ServiceError
from app.records.activity import Activity
from app.records.ids import is_id
from app.records.tables import ApiKey
from app.services.context import ServiceContext
from app.services.keys import find_key
from app.services.queries import POSE_ID

PUBLIC = ("/", "/livez", "/readyz", "/openapi.json", "/docs")
PUBLIC_FOLDER = "/docs/"
DETAILED_WITH_KEY = ("/readyz",)
"""Public addresses that say more to those who have a key."""
GRANTS = {
    "read": frozenset({"read"}),
    "ingest": frozenset({"ingest"}),
    "upload": frozenset({"read", "ingest", "upload"}),
    "admin": frozenset({"read", "ingest", "upload", "admin"}),
}
"""What a key of each scope holds."""
BY_METHOD = {"GET": "read", "POST": "upload", "PUT": "upload", "PATCH": "upload", "DELETE": "admin"}
OTHERWISE = {
    **dict.fromkeys(
        ("put_image", "create_image", "find_missing_images", "put_pose", "put_poses", "stream_events"),
        "ingest",
    ),
    **dict.fromkeys(
        ("create_key", "list_keys", "get_key", "update_key", "revoke_key", "list_audit"), "admin"
    ),
}
"""The operations whose scope is not their method's. `stream_events` is open to readers, too."""
_READERS_TOO = frozenset({"stream_events"})
FOR_LIMITED_KEYS = frozenset(
    {"list_sessions", "list_targets", "list_robots", "get_target", "get_robot", "create_dh_plan"}
)
"""What a key limited to sessions may do in addition to what is addressed below a session or a measurement: each of
these excludes what the key may not see."""
_BELOW = frozenset({"session_id", "measurement_id"})
_POSE = re.compile(POSE_ID)

log = structlog.get_logger(__name__)


def required_scopes(method: str, operation: str) -> frozenset[str]:
    """Return the scopes of which a key must hold one to send `method` to this operation."""
    needed = OTHERWISE.get(operation, BY_METHOD.get(method, "admin"))
    return frozenset({needed, "read"}) if operation in _READERS_TOO else frozenset({needed})


def open_to_limited_keys(operation: str, path_parameters: Iterable[str]) -> bool:
    """Return whether a key limited to sessions may use this operation at all."""
    return operation in FOR_LIMITED_KEYS or not _BELOW.isdisjoint(path_parameters)


def authorize(request: Request, operation: str) -> Activity:
    """Return what the caller is about to do. Raises NotAllowed where its key does not allow it."""
    key: ApiKey | None = request.state.key
    state = request.scope["state"]
    activity = Activity(
        actor="key" if key is not None else "anonymous",
        action=operation,
        client=state.get("client"),
        request_id=state.get("request_id"),
        object_ids=_named_objects(request),
        audited=request.method not in ("GET", "HEAD"),
    )
    if key is not None:
        activity.key_id, activity.key_name = key.id, key.name
        activity.has_quota = key.bytes_per_day is not None
        if key.session_ids is not None:
            activity.session_ids = frozenset(key.session_ids)
    state["activity"] = activity
    if key is not None:
        _require_scope(key, request.method, operation)
        if key.session_ids is not None and not open_to_limited_keys(operation, request.path_params):
            raise NotAllowed(
                "The API key is limited to sessions; this is beyond them.",
                "Use a key that is not limited to sessions.",
                code="key_limited_to_sessions",
            )
    return activity


def holds(request: Request, scope: str) -> bool:
    """Return whether the caller's key holds `scope`; with GRIDPOSE_AUTH=off everyone holds all."""
    key: ApiKey | None = request.state.key
    return key is None or scope in GRANTS[key.scope]


def _require_scope(key: ApiKey, method: str, operation: str) -> None:
    needed = required_scopes(method, operation)
    if GRANTS[key.scope].isdisjoint(needed):
        least = " or ".join(sorted(needed))
        raise NotAllowed(
            f"The API key's scope is {key.scope}; this needs {least}.",
            f"Use a key made with the scope {least}.",
        )


def _named_objects(request: Request) -> list[str]:
    """Return the ids and pose tags in the address; what cannot be one goes into no log."""
    return [
        text
        for name, value in request.path_params.items()
        if is_id(text := str(value)) or (name == "pose_id" and _POSE.fullmatch(text))
    ]


class ApiKeyAuth:
    """Refuses requests without a valid key (401)."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            state = scope.setdefault("state", {})
            state["key"] = None
            path: str = scope["path"]
            service = scope["app"].state.service
            asks_for_key = service.installation.settings.auth == "on"
            if asks_for_key and path not in PUBLIC and not path.startswith(PUBLIC_FOLDER):
                try:
                    key = await _authenticate(service.installation, Headers(scope=scope))
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
        return await _authenticate(installation, headers)
    except ServiceError:  # without the database, or without a key, the address answers all the same
        return None


async def _authenticate(installation: ServiceContext, headers: Headers) -> ApiKey:
    """Return the valid key of a request; raise NotAuthenticated if the request has no valid key."""
    kind, _, credentials = headers.get("authorization", "").partition(" ")
    credentials = credentials.strip()
    if kind.lower() != "bearer" or not credentials:
        raise NotAuthenticated("This address needs an API key.", "Send it as `Authorization: Bearer KEY`.")
    key = await run_in_threadpool(find_key, installation, credentials)
    if key is None:
        raise NotAuthenticated(
            "The API key is not valid.", "Check that it is complete, not expired and not revoked."
        )
    return key
