"""Stored qualifications as JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import Field

from app.api.schemas.analyses import AcceptanceDecision, QualificationAnalysis, QualificationCreate
from app.api.schemas.common import ResponseModel, StoredPage, Text
from app.api.schemas.fields import SessionId

_CAMERA = "The user's own name of the camera, such as its serial number; null: not stated."


class QualificationRecordCreate(QualificationCreate):
    """Known lengths that a session measured, and for how long what they show is to hold."""

    valid_days: Annotated[
        int, Field(ge=1, le=36500, description="After how many days the next qualification is due.")
    ] = 365
    camera_name: Annotated[Text | None, Field(description=_CAMERA)] = None


class QualificationRead(ResponseModel):
    """What known lengths showed of a set-up, and until when that holds; never changed or deleted."""

    id: Annotated[str, Field(description="Id of the qualification, made by the server.")]
    session_id: SessionId
    session_name: Annotated[str, Field(description="The session's name at that time.")]
    robot_id: Annotated[
        str | None, Field(description="The session's robot; null: the record is of the installation.")
    ]
    camera_name: Annotated[str | None, Field(description=_CAMERA)]
    made_at: Annotated[datetime, Field(description="When it was made, RFC 3339 in UTC.")]
    due_at: Annotated[datetime, Field(description="When the next one is due, RFC 3339 in UTC.")]
    decision: Annotated[
        AcceptanceDecision | None,
        Field(description="Whether every error is within the limit; null without a limit."),
    ]
    maximum_permissible_error_mm: Annotated[float | None, Field(description="The limit on errors, mm.")]
    worst_error_mm: Annotated[float, Field(description="The error of length that is largest in size, mm.")]
    probing_scatter_mm: Annotated[
        float | None, Field(description="Largest distance of a visit from its pose's mean, mm.")
    ]
    scale_ppm: Annotated[float, Field(description="By how much lengths were measured too long, ppm.")]
    made_by_name: Annotated[str | None, Field(description="Name of the key that made it; null without keys.")]


class ControlRead(ResponseModel):
    """Between what a figure was to be expected by earlier records: the chart of individuals."""

    centre: Annotated[
        float,
        Field(
            description="Mean of the earlier records, in the figure's unit; of the scatter the geometric one."
        ),
    ]
    low: Annotated[
        float,
        Field(
            description="Lower control limit: mean less 2.66 mean moving ranges, of the scatter by its logarithm."
        ),
    ]
    high: Annotated[float, Field(description="Upper control limit.")]
    records: Annotated[int, Field(description="Earlier records; limits of fewer than 20 are provisional.")]
    in_control: Annotated[bool, Field(description="Whether this record's figure lies between the limits.")]


class QualificationDetail(QualificationRead):
    """A qualification with its analysis, and compared with the earlier ones of the same robot and camera."""

    control_worst_error_mm: Annotated[
        ControlRead | None,
        Field(description="Of the worst error's size; null with fewer than five earlier records."),
    ]
    control_scale_ppm: Annotated[
        ControlRead | None, Field(description="Of the scale; null with fewer than five earlier records.")
    ]
    control_probing_scatter_mm: Annotated[
        ControlRead | None,
        Field(description="Of the probing scatter; null with fewer than five earlier records that have it."),
    ]
    analysis: Annotated[
        QualificationAnalysis,
        Field(description="The answer of `POST .../qualification` that the figures are from, whole."),
    ]


class QualificationPage(StoredPage):
    """One page of qualifications."""

    items: list[QualificationRead] = Field(
        description="Qualifications, oldest first, without their analyses."
    )
