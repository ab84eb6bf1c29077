"""Who may do what: what the scope and the limits of a key allow, of the API and of the dashboard.

Every route of the API, and every page, calls `authorize` before it examines address and body.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from starlette.requests import Request

from app.errors import NotAllowed
from app.records.activity import Activity
from app.records.ids import is_id
from app.records.tables import ApiKey
from app.services.queries import POSE_ID

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
        (
            *("create_key", "list_keys", "get_key", "update_key", "revoke_key", "list_audit"),
            *("create_webhook", "list_webhooks", "get_webhook", "delete_webhook", "create_webhook_test"),
            *("list_webhook_deliveries", "create_webhook_redelivery"),
        ),
        "admin",
    ),
}
"""The operations whose scope is not their method's. `stream_events` is open to readers, too."""
_READERS_TOO = frozenset({"stream_events"})
FOR_LIMITED_KEYS = frozenset(
    {
        "list_sessions",
        "list_targets",
        "list_robots",
        "get_target",
        "get_robot",
        "create_compensation",
        "create_dh_plan",
        "list_robot_events",
        "get_robot_history",
        "get_robot_history_plot",
        "get_report_comparison",
        "list_reports",
        "list_qualifications",
        "get_qualification",
    }
)
"""What a key limited to sessions may do in addition to what is addressed below a session or a measurement: each of
these excludes what the key may not see."""
_BELOW = frozenset({"session_id", "measurement_id", "report_id"})
_POSE = re.compile(POSE_ID)


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
