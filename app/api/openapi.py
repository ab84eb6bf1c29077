"""The OpenAPI document, brought to what generated clients can use."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from app.api.schemas.service import Problem
from app.settings import program_version

_DESCRIPTION = """\
Calibrated 6-D camera poses, with their uncertainty, from single images of a printed grid.

Every error is an RFC 9457 problem with a stable `code` and, where there is any, `advice`.
"""


def openapi_document(app: FastAPI) -> dict[str, Any]:
    """Return the application's OpenAPI document: problems by reference, one security scheme, no other unions."""
    document = get_openapi(
        title="Gridpose",
        version=program_version(),
        description=_DESCRIPTION,
        routes=app.routes,
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
    return document
