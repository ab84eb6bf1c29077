"""What all request and response bodies share: strictness, text that is seen as it is, bounded numbers."""

from __future__ import annotations

import re
import unicodedata
from datetime import UTC, datetime, timedelta
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


Code = Annotated[
    str,
    Field(description="Stable name in snake_case, for programs; docs/errors.md lists failures and warnings."),
]
Detail = Annotated[str, Field(description="What was found, in a sentence with its figures, for people.")]
Advice = Annotated[str | None, Field(description="What to do about it; null where nothing is to be done.")]
NextCursor = Annotated[
    str | None, Field(description="Pass it as `cursor` to get the next page; null on the last page.")
]


class AdvisoryRead(ResponseModel):
    """A warning or a piece of advice that accompanies a result."""

    code: Code
    detail: Detail
    advice: Advice


class FailureRead(ResponseModel):
    """Why something could not be computed, and what to do about it."""

    code: Code
    detail: Detail
    advice: Advice


class StoredPage(ResponseModel):
    """A page of stored rows."""

    next_cursor: NextCursor
    warnings: list[AdvisoryRead] = Field(
        description="One for each row of this page that is missing in `items` since it cannot be read "
        "(`row_unreadable`); empty in a sound database.",
    )


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
        moment = datetime.fromisoformat(value.upper().replace(" ", "T")).astimezone(UTC)
    except (ValueError, OverflowError):
        raise ValueError("is no date and time that exists") from None
    latest = datetime.now(UTC) + MAX_MOMENT_AHEAD
    if not MIN_MOMENT <= moment <= latest:
        raise ValueError(
            f"must lie between {MIN_MOMENT:%Y-%m-%d} and one day ahead of the server's clock, {latest:%Y-%m-%dT%H:%MZ}"
        )
    return moment


def visible_text(value: str) -> str:
    """Return a text that is seen as it is. Raises ValueError for one with invisible characters, or spaces alone."""
    if value.isspace():
        raise ValueError("consists of spaces alone; people are to read it")
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
MIN_MOMENT = datetime(1990, 1, 1, tzinfo=UTC)
MAX_MOMENT_AHEAD = timedelta(days=1)
"""A camera's clock may run ahead of the server's, or be set to another zone; beyond that it is simply wrong."""
POSE_LABEL = (
    "What people call the pose, where that is no pose ID, such as the folder's name `Größe 1` of `Groesse-1`."
)
CAPTURED = "When the image was taken: between 1990 and one day ahead of the server's clock."

Text = Annotated[str, Field(min_length=1, max_length=200, pattern=PRINTABLE), AfterValidator(visible_text)]
Identifier = Annotated[str, Field(min_length=1, max_length=64, pattern=PRINTABLE)]
PoseTag = Annotated[str, Field(min_length=1, max_length=128, pattern=r"^[A-Za-z0-9_-][A-Za-z0-9._-]*$")]
Sha256 = Annotated[
    str,
    Field(min_length=64, max_length=64, pattern=r"^[0-9A-Fa-f]{64}$"),
    AfterValidator(str.lower),
]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
PositiveLength = Annotated[float, Field(gt=0, le=MAX_LENGTH_MM)]
Coordinate = Annotated[float, Field(ge=-MAX_LENGTH_MM, le=MAX_LENGTH_MM)]
Angle = Annotated[float, Field(ge=-MAX_ANGLE_DEG, le=MAX_ANGLE_DEG)]
JointAngles = Annotated[list[Angle], Field(min_length=1, max_length=MAX_JOINTS)]
PlainDigits = BeforeValidator(_digits)
"""After a number's bounds, which then stay in the contract as `minimum` and `maximum`."""
MAX_BURST = 1000
Burst = Annotated[int, Field(ge=1, le=MAX_BURST), PlainDigits]
Cycle = Annotated[int, Field(ge=1, le=MAX_CYCLE), PlainDigits]
Moment = Annotated[datetime, BeforeValidator(_utc), Field(description=CAPTURED)]
