"""Sessions as JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.camera import StatedCamera
from app.api.schemas.common import (
    Identifier,
    RequestModel,
    ResponseModel,
    StoredPage,
    Text,
)
from app.api.schemas.fields import SessionId


class SessionLens(RequestModel):
    """What the lens and the sensor say about themselves: a prior on the focal length."""

    focal_length_mm: Annotated[
        float, Field(gt=0, le=1e5, description="Focal length engraved on the lens or in its data sheet, mm.")
    ]
    pixel_pitch_um: Annotated[
        float, Field(gt=0, le=1e4, description="Distance of neighbouring pixels on the sensor, µm.")
    ]


class SessionIntrinsics(StatedCamera):
    """A camera calibrated elsewhere; images then give their pose only."""


class SessionConditions(RequestModel):
    """Under what conditions the robot was measured, as ISO 9283 asks to be reported; null: not stated."""

    temperature_c: Annotated[
        float | None, Field(ge=-100, le=200, description="Temperature of the room, °C.", examples=[21.5])
    ] = None
    load_kg: Annotated[
        float | None, Field(ge=0, le=1e5, description="Mass that the robot carries, kg.", examples=[3.2])
    ] = None
    speed_percent: Annotated[
        float | None,
        Field(ge=0, le=100, description="Speed between poses, per cent of the rated one.", examples=[50.0]),
    ] = None
    warm_up_min: Annotated[
        float | None,
        Field(
            ge=0, le=1e5, description="How long the robot moved before the first image, min.", examples=[60.0]
        ),
    ] = None
    operator: Annotated[Text | None, Field(description="Who measured.", examples=["A. Tester"])] = None
    notes: Annotated[
        Text | None, Field(description="What else matters.", examples=["Brakes released between cycles."])
    ] = None


TargetIds = Annotated[
    list[Identifier],
    Field(
        min_length=1,
        max_length=16,
        description="Targets that the images may show, 1 to 16; an image sent without `target_id` is searched for all "
        "of them.",
    ),
]
SessionName = Annotated[
    Text, Field(description="What people call the session; need not be unique.", examples=["Cell 4, week 12"])
]
SessionRobot = Annotated[
    Identifier | None,
    Field(
        description="The robot whose nominal kinematics `dh`, `hand-eye` and exports use; null: not known."
    ),
]
Lens = Annotated[
    SessionLens | None,
    Field(
        description="Stated lens: a prior on the focal length for images that hardly determine it. Null: not stated."
    ),
]
Intrinsics = Annotated[
    SessionIntrinsics | None,
    Field(
        description="The camera, if it was calibrated elsewhere; images then give poses only. Null: estimated."
    ),
]

Conditions = Annotated[
    SessionConditions | None,
    Field(description="Conditions of the test; analyses repeat them in `subject`. Null: not stated."),
]

CameraMount = TypeAliasType(
    "CameraMount",
    Annotated[
        Literal["robot", "fixed"],
        Field(
            description="What the camera is on. `robot`: on the robot, before fixed targets (eye in hand). `fixed`: on "
            "a tripod or frame, the target on the robot's flange (eye to hand)."
        ),
    ],
)
SessionMount = Annotated[
    CameraMount,
    Field(
        description="What the camera is on; `robot` unless stated. Commanded poses are T_base_flange either way, so a "
        "change takes effect on all analyses and on no stored pose.",
        examples=["robot"],
    ),
]


def _on_robot() -> CameraMount:
    return "robot"


class SessionCreate(RequestModel):
    """A session to be made."""

    name: SessionName
    target_ids: TargetIds
    robot_id: SessionRobot = None
    lens: Lens = None
    intrinsics: Intrinsics = None
    conditions: Conditions = None
    # Without a default in the schema, where generated clients would ask for the field.
    camera_mount: SessionMount = Field(default_factory=_on_robot)


class SessionChange(SessionCreate):
    """What to change of a session; fields left away stay as they are."""

    # The factories make the fields optional without allowing null; what was not sent is never looked at.
    name: SessionName = Field(default_factory=str)
    target_ids: TargetIds = Field(default_factory=list)


class Counts(ResponseModel):
    """How many measurements of a session stand where; together, all of them."""

    queued: Annotated[int, Field(description="Of status `queued`: they wait to be computed.")]
    running: Annotated[int, Field(description="Of status `running`: they are computed now.")]
    succeeded: Annotated[
        int, Field(description="Of status `succeeded`: they have a calibration of their own.")
    ]
    failed: Annotated[int, Field(description="Of status `failed`, but for those that `duplicates` counts.")]
    duplicates: Annotated[
        int,
        Field(
            description="Of status `failed` with the code `target_already_measured`: their images were measured "
            "before, as `siblings` says. Nothing is lost, and nothing is to be done."
        ),
    ]


class SessionRead(ResponseModel):
    """A session as stored, with the counts of its measurements."""

    id: SessionId
    name: Annotated[str, Field(description="What people call the session.")]
    target_ids: Annotated[
        list[str], Field(description="Targets that the images may show, in the order given.")
    ]
    robot_id: Annotated[
        str | None, Field(description="The robot whose nominal kinematics analyses use; null: not known.")
    ]
    lens: Lens
    intrinsics: Intrinsics
    conditions: Conditions
    camera_mount: SessionMount
    created_at: Annotated[datetime, Field(description="When the session was made, RFC 3339 in UTC.")]
    counts: Annotated[Counts, Field(description="Its measurements by status.")]


class SessionPage(StoredPage):
    """One page of sessions."""

    items: Annotated[list[SessionRead], Field(description="Sessions, oldest first.")]


ReprocessedMeasurements = TypeAliasType(
    "ReprocessedMeasurements",
    Annotated[
        Literal["failed", "all"], Field(description="Which measurements of a session are computed again.")
    ],
)


class ReprocessCreate(RequestModel):
    """Which measurements of a session to compute again."""

    only: ReprocessedMeasurements = Field(
        default="failed",
        description="`failed`: those without a calibration, and those whose last retry computed nothing. `all`: every "
        "one, for instance after a change of the session's lens.",
        examples=["failed"],
    )


class ReprocessRead(ResponseModel):
    """What was queued."""

    requeued: int = Field(description="How many measurements were queued again.", examples=[3])
    counts: Counts = Field(description="The session's counts after it.")
