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
    """Classic (distal) Denavit-Hartenberg parameters of one joint: Rz(θ + theta_offset) Tz(d) Tx(a) Rx(α), and Ry(β)
    where it is stated.
    """

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
    beta_deg: Annotated[
        Angle | None,
        Field(
            description="Hayati's second turn about y, degrees, of a robot that was identified, where this axis is "
            "near parallel to the next: `alpha_deg` is within 11.5° of 0 or of half a turn, and so is this one of 0. "
            "Null: not used."
        ),
    ] = None
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


Name = Annotated[
    Text,
    Field(description="What people call the robot; need not be unique.", examples=["KR 5 arc, cell 4"]),
]
Joints = Annotated[
    list[Joint],
    Field(min_length=1, max_length=12, description="The robot's joints in order, the first at the base."),
]
JointCoupling = Annotated[
    list[Annotated[list[Annotated[float, Field(ge=-100, le=100)]], Field(min_length=1, max_length=12)]]
    | None,
    Field(
        min_length=1,
        max_length=12,
        description="n x n for n joints: the model's joint angles are this matrix times the stated ones. Null: they "
        "are the stated ones.",
    ),
]
Manufacturer = Annotated[Text | None, Field(description="Who made the robot; null: not known.")]
Model = Annotated[Text | None, Field(description="What its maker calls it; null: not known.")]
SerialNumber = Annotated[
    Text | None, Field(description="The number on its plate, by which reports name this one robot.")
]
DatasheetRepeatability = Annotated[
    Annotated[float, Field(gt=0, le=1e6)] | None,
    Field(description="Position repeatability (RP_l) that the maker states, mm; null: not known."),
]
DatasheetAccuracy = Annotated[
    Annotated[float, Field(gt=0, le=1e6)] | None,
    Field(description="Position accuracy (AP_p) that the maker states, mm; null: not known."),
]


class RobotCreate(RequestModel):
    """A robot: its nominal kinematics, who made it, and what its data sheet states."""

    name: Name
    joints: Joints
    joint_coupling: JointCoupling = None
    manufacturer: Manufacturer = None
    model: Model = None
    serial_number: SerialNumber = None
    datasheet_repeatability_mm: DatasheetRepeatability = None
    datasheet_accuracy_mm: DatasheetAccuracy = None


class RobotChange(RobotCreate):
    """What to change of a robot; fields left away stay as they are."""

    # The factories make the fields optional without allowing null; what was not sent is never looked at.
    name: Name = Field(default_factory=str)
    joints: Joints = Field(default_factory=list)


class RobotRead(ResponseModel):
    """A robot as stored."""

    id: RobotId
    name: Annotated[str, Field(description="What people call the robot.")]
    joints: Annotated[list[Joint], Field(description="The robot's joints in order, the first at the base.")]
    joint_coupling: Annotated[
        list[list[float]] | None,
        Field(
            description="n x n: the model's joint angles are this matrix times the stated ones; null: they are the "
            "stated ones."
        ),
    ]
    manufacturer: Annotated[str | None, Field(description="Who made the robot; null: not known.")]
    model: Annotated[str | None, Field(description="What its maker calls it; null: not known.")]
    serial_number: Annotated[str | None, Field(description="The number on its plate; null: not known.")]
    datasheet_repeatability_mm: Annotated[
        float | None,
        Field(description="Position repeatability (RP_l) that the maker states, mm; null: not known."),
    ]
    datasheet_accuracy_mm: Annotated[
        float | None,
        Field(description="Position accuracy (AP_p) that the maker states, mm; null: not known."),
    ]


class RobotPage(StoredPage):
    """One page of robots."""

    items: Annotated[list[RobotRead], Field(description="Robots, oldest first.")]
