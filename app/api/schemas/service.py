"""Problems and health as JSON."""

from __future__ import annotations

from app.api.schemas.common import ResponseModel


class FieldProblem(ResponseModel):
    """What is wrong with one field."""

    field: str
    message: str


class Problem(ResponseModel):
    """What went wrong, as RFC 9457 has it, with a stable code and advice."""

    type: str
    title: str
    status: int
    detail: str
    code: str
    advice: str | None
    errors: list[FieldProblem]


class Liveness(ResponseModel):
    status: str


class HealthCheck(ResponseModel):
    name: str
    ok: bool
    detail: str


class Readiness(ResponseModel):
    """Each part by name."""

    status: str
    version: str
    checks: list[HealthCheck]
