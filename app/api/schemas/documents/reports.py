"""Stored reports as JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import FailureRead, RequestModel, ResponseModel, StoredPage, Text
from app.api.schemas.fields import SessionId
from app.api.schemas.measurements import MeasurementStatus

ReportKind = TypeAliasType(
    "ReportKind",
    Annotated[
        Literal["repeatability", "kinematics", "camera", "session"],
        Field(description="What a report is on."),
    ],
)
ReportFormName = TypeAliasType(
    "ReportFormName",
    Annotated[
        Literal["json", "html", "pdf", "csv", "xml"], Field(description="In what form a report is stored.")
    ],
)
Paper = TypeAliasType(
    "Paper", Annotated[Literal["a4", "letter"], Field(description="Paper of a report's PDF.")]
)
InputKind = TypeAliasType(
    "InputKind",
    Annotated[
        Literal["session", "robot", "target", "pose", "image", "measured_pose"],
        Field(description="What kind of thing an input of a report is."),
    ],
)
RecomputedFrom = TypeAliasType(
    "RecomputedFrom",
    Annotated[
        Literal["report", "report_and_session", "nothing"],
        Field(description="What a verification computes the figures of a report from."),
    ],
)
_TITLE = "What stands at the head of the report."


class Signatory(RequestModel):
    """Who is to sign a report by hand: a line in the PDF and in the HTML form."""

    name: Annotated[Text, Field(description="The person's name.", examples=["R. Meier"])]
    role: Annotated[
        Text | None, Field(description="As what they sign; null leaves it open.", examples=["operator"])
    ] = None


class ReportCreate(RequestModel):
    """A report to make."""

    kind: Annotated[
        ReportKind,
        Field(
            description="`repeatability`: poses by ISO 9283. `kinematics`: identified Denavit-Hartenberg parameters. "
            "`camera`: intrinsics with uncertainties. `session`: all measurements, camera and repeatability in short."
        ),
    ]
    title: Annotated[Text | None, Field(description=f"{_TITLE} Null: the kind and the session's name.")] = (
        None
    )
    signatories: Annotated[
        list[Signatory],
        Field(default_factory=list, max_length=10, description="Who is to sign, in this order; ten at most."),
    ]
    paper: Annotated[Paper, Field(description="Paper of the PDF.")] = "a4"


class SignatoryRead(ResponseModel):
    """Who is to sign a report by hand."""

    name: Annotated[str, Field(description="The person's name.")]
    role: Annotated[str | None, Field(description="As what they sign; null: left open.")]


class StoredForm(ResponseModel):
    """One form of a report."""

    form: Annotated[ReportFormName, Field(description="The ending of its address: `/v1/reports/{id}.pdf`.")]
    sha256: Annotated[str, Field(description="SHA-256 of its bytes, 64 hex digits.")]
    bytes: Annotated[int, Field(description="Its size, bytes.")]


class ReportRead(ResponseModel):
    """A report: what it is on, how far it is, and the hashes of its forms."""

    id: Annotated[str, Field(description="Id of the report; opaque, made by the server.")]
    session_id: SessionId
    kind: Annotated[ReportKind, Field(description="What it is on.")]
    title: Annotated[str, Field(description=_TITLE)]
    signatories: Annotated[list[SignatoryRead], Field(description="Who is to sign it by hand.")]
    paper: Annotated[Paper, Field(description="Paper of its PDF.")]
    status: Annotated[
        MeasurementStatus,
        Field(description="`succeeded` once all forms are stored; `failure` says why it failed."),
    ]
    failure: Annotated[
        FailureRead | None, Field(description="Why it could not be made; null unless `failed`.")
    ]
    created_at: Annotated[datetime, Field(description="When it was ordered, RFC 3339 in UTC.")]
    finished_at: Annotated[
        datetime | None, Field(description="When it was made, or failed, RFC 3339 in UTC; null until then.")
    ]
    made_by: Annotated[
        str | None, Field(description="Id of the key that ordered it; null with GRIDPOSE_AUTH=off.")
    ]
    made_by_name: Annotated[
        str | None, Field(description="That key's name when the report was ordered; null without a key.")
    ]
    core_version: Annotated[
        str | None, Field(description="Version and build that made it; null until it is made.")
    ]
    inputs_sha256: Annotated[
        str | None, Field(description="Hash of everything it was made from; null until it is made.")
    ]
    signing_key: Annotated[
        str | None,
        Field(
            description="Fingerprint of the key that signed it: SHA-256 of the Ed25519 public key, 64 hex digits; null "
            "until it is made."
        ),
    ]
    forms: Annotated[list[StoredForm], Field(description="Its forms; empty until it is made.")]


class ReportPage(StoredPage):
    """One page of reports."""

    items: Annotated[list[ReportRead], Field(description="Reports, oldest first.")]


class FigureDifference(ResponseModel):
    """A figure that is not the same when computed anew."""

    path: Annotated[
        str, Field(description="Its place in the document: `repeatability.poses[P1].repeatability.rp_l_mm`.")
    ]
    then: Annotated[str | None, Field(description="Its value in the report; null: not known, or absent.")]
    now: Annotated[str | None, Field(description="Its value computed anew; null: not known, or absent.")]
    relative_difference: Annotated[
        float | None, Field(description="Difference over the larger of both; null for what is no number.")
    ]
    in_uncertainties: Annotated[
        float | None,
        Field(
            description="Difference over the figure's standard uncertainty in the report, that of an uncertainty over "
            "itself; null: the report states none."
        ),
    ]


class ChangedInput(ResponseModel):
    """Something that the report was made from and is not the same now."""

    noun: Annotated[
        InputKind,
        Field(description="What kind of thing it is."),
    ]
    name: Annotated[str, Field(description="Its id, or the pose's tag.")]
    detail: Annotated[
        str,
        Field(
            description="What became of it, in words: `excluded: hand in view`, `moved from P1 cycle 3 to P2 cycle 3`, "
            "`added`, `deleted`, `original missing`, `changed:` with the values before and now."
        ),
    ]


class DifferingOriginal(ResponseModel):
    """An image that gives other grid points today."""

    measurement_id: Annotated[str, Field(description="Id of the measurement.")]
    detail: Annotated[str, Field(description="What is different.")]
    largest_point_difference_px: Annotated[
        float | None, Field(description="Largest distance of a grid point, px; null where others are found.")
    ]


class OriginalsCheck(ResponseModel):
    """Originals that were decoded and measured anew."""

    measured: Annotated[int, Field(description="Measurements made anew; 0 with `originals=false`.")]
    identical: Annotated[int, Field(description="Of them, those that give the same bytes again.")]
    largest_point_difference_px: Annotated[
        float | None,
        Field(description="Largest distance of a grid point from the stored one, px; null: none."),
    ]
    differing: Annotated[
        list[DifferingOriginal], Field(description="Images that give other grid points, beyond 1e-6 px.")
    ]


class ReportVerification(ResponseModel):
    """A report compared with what it was made from, computed anew."""

    report_id: Annotated[str, Field(description="Id of the report.")]
    agrees: Annotated[
        bool,
        Field(
            description="Whether every figure, computed anew from what the report was made from, agrees to six "
            "significant digits or 1e-9 of its unit, every text exactly, every form is as it was signed, and every "
            "original is as it was and gives the same grid points. What was changed in the session since does not "
            "count: `is_current`."
        ),
    ]
    is_current: Annotated[
        bool,
        Field(
            description="Whether the session still holds what the report was made from, so that a report made now has "
            "the same figures; `changed_inputs` names what was changed since."
        ),
    ]
    recomputed_from: Annotated[
        RecomputedFrom,
        Field(
            description="`report`: grid points that are stored, all else as the "
            "report states it. `report_and_session`: the same, and `current_values` as the session has them now. "
            "`nothing`: no figure can be computed, `unavailable_inputs` are not stored any more; `agrees` is false."
        ),
    ]
    current_values: Annotated[
        list[str],
        Field(
            description="Fields that the report, made by an earlier version, does not state: `image.failure_detail`."
        ),
    ]
    unavailable_inputs: Annotated[
        list[ChangedInput],
        Field(
            description="What the figures cannot be computed without and is not stored as it was: a deleted image, one "
            "measured again to other grid points; 100 at most."
        ),
    ]
    unavailable_input_count: Annotated[int, Field(description="How many inputs are not stored as they were.")]
    figures: Annotated[int, Field(description="Figures compared; 0 where none can be computed.")]
    figures_equal: Annotated[int, Field(description="Of them, those with all digits equal.")]
    largest_relative_difference: Annotated[
        float | None, Field(description="Of all numbers; null where nothing could be compared.")
    ]
    largest_difference_in_uncertainties: Annotated[
        float | None,
        Field(
            description="Of all numbers whose standard uncertainty the report states, the largest difference over it; "
            "null where nothing could be compared."
        ),
    ]
    digits: Annotated[
        int | None,
        Field(description="Significant digits that all numbers share at least; null where all are equal."),
    ]
    differences: Annotated[
        list[FigureDifference],
        Field(description="Figures that are not the same, the gravest first; 100 at most."),
    ]
    changed_inputs: Annotated[
        list[ChangedInput], Field(description="Inputs that are not the same now; 100 at most.")
    ]
    changed_input_count: Annotated[int, Field(description="How many inputs are not the same now.")]
    damaged_forms: Annotated[
        list[ReportFormName], Field(description="Stored forms whose bytes are not those that were signed.")
    ]
    originals: Annotated[OriginalsCheck, Field(description="What the images give when measured anew.")]
    core_version_then: Annotated[str, Field(description="Version and build that made the report.")]
    core_version_now: Annotated[str, Field(description="Version and build that verified it.")]
