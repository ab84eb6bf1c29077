"""Problems and health as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import ResponseModel

Health = TypeAliasType("Health", Annotated[Literal["ok"], Field(description="That all is well.")])


class FieldProblem(ResponseModel):
    """What is wrong with one field."""

    field: Annotated[
        str, Field(description="Path of the field in body, query or form, such as `joints.0.a_mm`.")
    ]
    message: Annotated[str, Field(description="What is wrong with it, or what it must be.")]


class Problem(ResponseModel):
    """What went wrong, as RFC 9457 has it, with a stable code and advice."""

    type: Annotated[
        str, Field(description="URN of the problem's kind: `urn:gridpose:problem:` and the code.")
    ]
    title: Annotated[str, Field(description="The kind of the problem in a few words, such as `Not found`.")]
    status: Annotated[int, Field(description="The HTTP status code of the answer.")]
    detail: Annotated[str, Field(description="What happened this time, with figures, for people.")]
    code: Annotated[
        str, Field(description="Stable name in snake_case, for programs; docs/errors.md lists all of them.")
    ]
    advice: Annotated[str | None, Field(description="What to do next; null where there is no advice.")]
    errors: Annotated[
        list[FieldProblem],
        Field(description="Each field that is not valid; empty where no field is the cause."),
    ]


class Liveness(ResponseModel):
    """That the process answers."""

    status: Annotated[Health, Field(description="The process answers.")]


class HealthCheck(ResponseModel):
    """One part of the service and whether it works."""

    name: Annotated[str, Field(description="The part that was checked, such as `database`.")]
    ok: Annotated[bool, Field(description="Whether the part works.")]
    detail: Annotated[str, Field(description="What the check found, for people.")]


class Readiness(ResponseModel):
    """Whether the service can do its work; with a valid key, its version and each part by name."""

    status: Annotated[Health, Field(description="Always `ok`; a service that is not ready answers 503.")]
    version: Annotated[
        str | None, Field(description="Version and build of the numerics; missing without a valid key.")
    ] = None
    checks: Annotated[
        list[HealthCheck] | None, Field(description="Each part by name; missing without a valid key.")
    ] = None
