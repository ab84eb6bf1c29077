"""Events of robots as JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import AfterValidator, Field

from app.api.schemas.common import PRINTABLE, Moment, RequestModel, ResponseModel, StoredPage, visible_text
from app.api.schemas.fields import RobotId

_AT = "When it was done."
_NOTE = "What was done, in one line of at most 500 characters."
_RESTARTS = (
    "Whether figures measured before and after it are not to be compared, as after a new gearbox: control charts begin "
    "anew."
)


class RobotEventCreate(RequestModel):
    """Something done to a robot."""

    at: Annotated[
        Moment,
        Field(description=f"{_AT} Between 1990 and one day ahead of the server's clock, RFC 3339."),
    ]
    note: Annotated[
        Annotated[str, Field(min_length=1, max_length=500, pattern=PRINTABLE), AfterValidator(visible_text)],
        Field(description=_NOTE, examples=["Belt of joint 5 replaced"]),
    ]
    restarts_charts: Annotated[bool, Field(description=_RESTARTS)] = False


class RobotEventRead(ResponseModel):
    """Something done to a robot, as stored."""

    id: Annotated[str, Field(description="Id of the event; opaque, made by the server.")]
    robot_id: RobotId
    at: Annotated[datetime, Field(description=f"{_AT} RFC 3339 in UTC.")]
    note: Annotated[str, Field(description=_NOTE)]
    restarts_charts: Annotated[bool, Field(description=_RESTARTS)]
    created_at: Annotated[datetime, Field(description="When it was noted, RFC 3339 in UTC.")]
    made_by_name: Annotated[
        str | None, Field(description="Name of the key that noted it; null without a key.")
    ]


class RobotEventPage(StoredPage):
    """One page of a robot's events."""

    items: Annotated[list[RobotEventRead], Field(description="Events in the order in which they were noted.")]
