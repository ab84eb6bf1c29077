"""Robots as JSON."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.common import (
    Angle,
    Coordinate,
    RequestModel,
    ResponseModel,
    StoredPage,
    Text,
)
from app.api.schemas.fields import RobotId


class Joint(RequestModel):
    """Classic (distal) Denavit-Hartenberg parameters of one joint: Rz(θ + theta_offset) Tz(d) Tx(a) Rx(α)."""

    a_mm: Annotated[
        Coordinate,
        Field(description="Link length: from this joint's axis to the next along their common normal, mm."),
    ]
    alpha_deg: Annotated[
        Angle,
        Field(description="Link twist: from this joint's axis to the next about the common normal, degrees."),
    ]
    d_mm: Annotated[Coordinate, Field(description="Joint offset along this joint's axis, mm.")]
    theta_offset_deg: Annotated[
        Angle, Field(description="What is added to the stated joint angle about this joint's axis, degrees.")
    ] = 0.0
    name: Annotated[
        Text | None, Field(description="The maker's name of the joint, for files of other programs.")
    ] = None
    minimum_deg: Annotated[
        Angle | None,
        Field(
            description="Lower limit of the stated joint angle, degrees; together with `maximum_deg`, or "
            "neither. Null: "
            "no limit."
        ),
    ] = None
    maximum_deg: Annotated[
        Angle | None,
        Field(
            description="Upper limit of the stated joint angle, degrees; above `minimum_deg`. Null: no limit."
        ),
    ] = None


class RobotCreate(RequestModel):
    """A robot's nominal kinematics."""

    name: Annotated[
        Text,
        Field(description="What people call the robot; need not be unique.", examples=["KR 5 arc, cell 4"]),
    ]
    joints: Annotated[
        list[Joint],
        Field(min_length=1, max_length=12, description="The robot's joints in order, the first at the base."),
    ]
    datasheet_repeatability_mm: Annotated[
        Annotated[float, Field(ge=0, le=1e6)] | None,
        Field(description="Position repeatability (RP_l) that the maker states, mm; null: not known."),
    ] = None


class RobotRead(ResponseModel):
    """A robot as stored."""

    id: RobotId
    name: Annotated[str, Field(description="What people call the robot.")]
    joints: Annotated[list[Joint], Field(description="The robot's joints in order, the first at the base.")]
    datasheet_repeatability_mm: Annotated[
        float | None,
        Field(description="Position repeatability (RP_l) that the maker states, mm; null: not known."),
    ]


class RobotPage(StoredPage):
    """One page of robots."""

    items: Annotated[list[RobotRead], Field(description="Robots, oldest first.")]
