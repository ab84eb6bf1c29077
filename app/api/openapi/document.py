"""The OpenAPI document, in a form that client generators accept."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from app.api.openapi.examples import add_examples
from app.api.schemas.system import Problem
from app.build import program_version

_DESCRIPTION = """\
Calibrated 6-D camera poses, with their uncertainty, from single images of a printed grid; from the images of a session
the camera, the robot's repeatability by ISO 9283, its Denavit-Hartenberg parameters and its hand-eye calibration.

**Start here**

1. `POST /v1/targets`: describe the printed grid.
2. `POST /v1/sessions` with the target's id: a session is one camera, looking at one or more targets.
3. `PUT /v1/sessions/{session_id}/poses/{pose_id}/images/{sha256}`: send each image; it is queued and measured.
4. `GET /v1/sessions/{session_id}`: wait until `counts` has neither `queued` nor `running` images.
5. `GET /v1/sessions/{session_id}/camera-poses`, `/intrinsics`, `/repeatability`, `/dh`, `/hand-eye`: the results.

For `dh` and `hand-eye` also store the robot (`POST /v1/robots`) and its commanded poses
(`POST /v1/sessions/{session_id}/poses`).

**Conventions.** Send `Authorization: Bearer KEY`. Lengths are in mm, angles in degrees, image coordinates in px with
(0, 0) at the centre of the top-left pixel; the unit is a suffix of the name. Covariances are in mm and rad. Times are
RFC 3339 in UTC. `T_a_b` maps points of frame b into frame a. R = Rz(yaw) Ry(pitch) Rx(roll). The target's x axis is
along its columns, y along its rows, and z points into the board; the camera's z is its optical axis. A standard
uncertainty is one standard deviation.

**Examples** are of a real run; long lists in them are shortened.

**Errors.** Every error is an RFC 9457 problem with a stable `code` and, where there is any, `advice`.
"""

_TAGS = {
    "targets": "Printed grids: what images show, with its dimensions and the uncertainty of its pitch.",
    "robots": "Robots with their nominal Denavit-Hartenberg parameters.",
    "sessions": "A session: one camera, its targets, perhaps a robot, and everything measured with them.",
    "poses": "The robot's poses by the user's own tags, with what was commanded.",
    "measured poses": "Poses that a laser tracker or another instrument measured, in place of images.",
    "measurements": "Images in; for each its grid points, camera and pose out, as figures and as drawings.",
    "analyses": "Results over all images of a session, as JSON and as plots, and the planning of poses.",
    "qualifications": "Records of what known lengths showed of a set-up, and until when that holds.",
    "reports": "Stored reports to file and sign: made once, in several forms, and verified at any time.",
    "webhooks": "Addresses that notices of what happened are sent to, and the journal of that. Needs scope `admin`.",
    "keys": "API keys: scopes, sessions they are limited to, quotas. Needs scope `admin`.",
    "audit": "Who changed what, when and from where. Needs scope `admin`.",
    "service": "Health, metrics and the progress of a session.",
}
"""Every tag of the routes, in the order in which the documentation page shows them."""


_BOUNDS = frozenset({"minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"})


def openapi_document(app: FastAPI) -> dict[str, Any]:
    """Return the application's OpenAPI document: problems by reference, one security scheme, no other unions."""
    document = get_openapi(
        title="Gridpose",
        version=program_version(),
        description=_DESCRIPTION,
        routes=app.routes,
        license_info={"name": "Apache License 2.0", "identifier": "Apache-2.0"},
        servers=[{"url": "/", "description": "The service that this document comes from."}],
        tags=[{"name": name, "description": text} for name, text in _TAGS.items()],
    )
    schemas = document.setdefault("components", {}).setdefault("schemas", {})
    problem = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas.update(problem.pop("$defs"))
    schemas["Problem"] = problem
    document["components"]["securitySchemes"] = {
        "key": {"type": "http", "scheme": "bearer", "description": "An API key, `gp_…`."}
    }
    document["security"] = [{"key": []}]
    for path in document["paths"].values():
        for operation in path.values():
            operation["tags"] = [tag for tag in operation.get("tags", []) if tag != "bulk"]
            # FastAPI adds its own validation error wherever a path has a parameter; ours is a problem, or none is due.
            if "application/json" in operation["responses"].get("422", {}).get("content", {}):
                del operation["responses"]["422"]
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    _state_whole_bounds(document)
    add_examples(document)
    return document


def _state_whole_bounds(node: Any) -> None:
    """State the bounds of whole numbers as such, in place: 500, where the schema says 500.0."""
    if isinstance(node, list):
        for value in node:
            _state_whole_bounds(value)
    elif isinstance(node, dict):
        if node.get("type") == "integer":
            for name in _BOUNDS & node.keys():
                node[name] = int(node[name])
        for value in node.values():
            _state_whole_bounds(value)
