"""What all request and response bodies share: strictness, text that is seen as it is, bounded numbers."""

from __future__ import annotations

import re
import unicodedata
from datetime import UTC, datetime
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

PRINTABLE = r"^[^\x00-\x1f\x7f-\x9f]*$"
_DIGITS = re.compile(r"[0-9]{1,10}", re.ASCII)
_RFC3339 = re.compile(
    r"[0-9]{4}-[0-9]{2}-[0-9]{2}[Tt ][0-9]{2}:[0-9]{2}:[0-9]{2}(\.[0-9]{1,9})?([Zz]|[+-][0-9]{2}:[0-9]{2})",
    re.ASCII,
)
_INVISIBLE = ("Cf", "Zl", "Zp")
"""Unicode's categories of what is not seen and may turn, join or break the text around it. `PRINTABLE` refuses the
control characters; these are too scattered for a pattern."""
_LIST = re.compile(r"[-+0-9.eE]+( *, *[-+0-9.eE]+)*", re.ASCII)


class RequestModel(BaseModel):
    """A request body: nothing unknown, nothing coerced, nothing that JSON has no number for."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class ResponseModel(BaseModel):
    """A response body."""

    model_config = ConfigDict(from_attributes=True)


def _digits(value: Any) -> Any:
    if isinstance(value, str) and not _DIGITS.fullmatch(value):
        raise ValueError("must be a whole number in plain digits")
    return value


def _utc(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    if not _RFC3339.fullmatch(value):
        raise ValueError("must be a time as RFC 3339 has it, with its offset, such as 2026-01-31T12:00:00Z")
    try:
        moment = datetime.fromisoformat(value.upper().replace(" ", "T"))
        return moment.astimezone(UTC)
    except (ValueError, OverflowError):
        raise ValueError("is no date and time that exists") from None


def _visible(value: str) -> str:
    if any(unicodedata.category(character) in _INVISIBLE for character in value):
        raise ValueError(
            "has invisible characters that steer how text is shown, such as U+202E; leave them out"
        )
    return value


def parse_joint_angles(text: str) -> list[float]:
    """Return the numbers of a comma-separated list, degrees."""
    if not _LIST.fullmatch(text):
        raise ValueError("must be numbers separated by commas")
    try:
        angles = [float(part) for part in text.split(",")]
    except ValueError:
        raise ValueError("must be numbers separated by commas") from None
    if len(angles) > MAX_JOINTS:
        raise ValueError(f"may have at most {MAX_JOINTS} numbers")
    if not all(abs(angle) <= MAX_ANGLE_DEG for angle in angles):
        raise ValueError(f"must be numbers from -{MAX_ANGLE_DEG:g} to {MAX_ANGLE_DEG:g}")
    return angles


MAX_JOINTS = 12
MAX_ANGLE_DEG = 1e6
MAX_LENGTH_MM = 1e9
MAX_CYCLE = 2**31 - 1

Text = Annotated[str, Field(min_length=1, max_length=200, pattern=PRINTABLE), AfterValidator(_visible)]
Identifier = Annotated[str, Field(min_length=1, max_length=64, pattern=PRINTABLE)]
PoseTag = Annotated[str, Field(min_length=1, max_length=128, pattern=r"^[A-Za-z0-9_-][A-Za-z0-9._-]*$")]
Sha256 = Annotated[
    str,
    Field(min_length=64, max_length=64, pattern=r"^[0-9A-Fa-f]{64}$"),
    AfterValidator(str.lower),
]
PositiveLength = Annotated[float, Field(gt=0, le=MAX_LENGTH_MM)]
Coordinate = Annotated[float, Field(ge=-MAX_LENGTH_MM, le=MAX_LENGTH_MM)]
Angle = Annotated[float, Field(ge=-MAX_ANGLE_DEG, le=MAX_ANGLE_DEG)]
JointAngles = Annotated[list[Angle], Field(min_length=1, max_length=MAX_JOINTS)]
PlainInt = Annotated[int, BeforeValidator(_digits)]
Cycle = Annotated[int, BeforeValidator(_digits), Field(ge=1, le=MAX_CYCLE)]
Moment = Annotated[datetime, BeforeValidator(_utc)]
