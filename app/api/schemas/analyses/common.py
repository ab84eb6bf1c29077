"""Fields that all analyses of a session share."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

from app.api.schemas.common import AdvisoryRead, Code, Detail, ResponseModel
from app.api.schemas.fields import (
    CoreVersion,
    Estimator,
    MeasuredPoseOrNull,
    MeasurementOrNull,
    SessionId,
    Source,
)
from app.api.schemas.sessions import Conditions, SessionMount

AcceptanceDecision = TypeAliasType(
    "AcceptanceDecision",
    Annotated[
        Literal["pass", "fail", "inconclusive"],
        Field(description="Whether a limit is kept; between the two lies what the intervals leave open."),
    ],
)
Matrix = list[list[float]]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Interval = Annotated[list[float], Field(min_length=2, max_length=2)]
Pending = Annotated[int, Field(description="Images not measured yet, which this analysis does not wait for.")]
SourceField = Annotated[
    Source,
    Field(
        description="`images`: poses estimated from images. `measured_poses`: those another instrument measured."
    ),
]

EstimatorField = Annotated[
    Estimator,
    Field(description="How images are combined; the query parameter of other analyses lists the ways."),
]


class NamedObject(ResponseModel):
    """A session, robot or target by its id and the name that people gave it."""

    id: Annotated[str, Field(description="Its id; opaque, made by the server.")]
    name: Annotated[str, Field(description="What people call it; need not be unique.")]


class QualificationCite(ResponseModel):
    """The qualification that holds for a set-up; whether it is due depends on when that is asked."""

    id: Annotated[str, Field(description="Id of the qualification.")]
    made_at: Annotated[datetime, Field(description="When it was made, RFC 3339 in UTC.")]
    due_at: Annotated[datetime, Field(description="When the next one is due, RFC 3339 in UTC.")]
    decision: Annotated[
        AcceptanceDecision | None,
        Field(description="Whether its limit was kept; null: no limit was stated."),
    ]


class AnalysisSubject(ResponseModel):
    """What an analysis is about."""

    session: Annotated[NamedObject, Field(description="The session whose measurements are analysed.")]
    robot: Annotated[
        NamedObject | None, Field(description="The session's robot; null for a session without `robot_id`.")
    ]
    targets: Annotated[list[NamedObject], Field(description="The session's targets, in its order.")]
    first_captured_at: Annotated[
        datetime | None,
        Field(
            description="When the first image was taken, RFC 3339 in UTC; null where no image states its time."
        ),
    ]
    last_captured_at: Annotated[
        datetime | None,
        Field(
            description="When the last image was taken, RFC 3339 in UTC; null where no image states its time."
        ),
    ]
    conditions: Conditions
    qualification: Annotated[
        QualificationCite | None,
        Field(
            description="The latest qualification, by the same source, of the robot or else of the installation "
            "(`/v1/qualifications`); null for none."
        ),
    ]
    camera_mount: SessionMount


class ExcludedRead(ResponseModel):
    """A measurement that does not count, and why."""

    measurement_id: MeasurementOrNull
    measured_pose_id: MeasuredPoseOrNull
    filename: Annotated[
        str | None,
        Field(description="The image's file by the name it was sent with; null where none was stated."),
    ]
    code: Code
    detail: Detail


class AnalysisHead(ResponseModel):
    """What every analysis says of itself."""

    session_id: SessionId
    subject: Annotated[AnalysisSubject, Field(description="Session, robot and targets by name, and when.")]
    inputs_sha256: Annotated[
        str,
        Field(
            description="Hash of everything the analysis was computed from: images by pose, cycle, hash and metadata, "
            "commanded poses, targets, settings and the program's version; no ids, no times."
        ),
    ]
    core_version: CoreVersion
    pending: Pending
    excluded: Annotated[
        list[ExcludedRead],
        Field(
            description="Every measurement that does not count, by rule or by the user, each once, in the order of "
            "pose, cycle and image. Outliers count, or are listed as such."
        ),
    ]
    warnings: Annotated[
        list[AdvisoryRead],
        Field(description="What to know of the whole answer; empty where there is nothing."),
    ]


class EstimatedAnalysis(AnalysisHead):
    """What an analysis by a chosen estimator says of itself."""

    estimator: Annotated[
        Estimator,
        Field(description="How the images were combined, as asked for; the query parameter lists the ways."),
    ]


class TargetTransform(ResponseModel):
    """How two targets lie to one another, by images that show both or by way of the robot."""

    from_target_id: Annotated[str, Field(description="The first target, in whose frame the transform is.")]
    to_target_id: Annotated[str, Field(description="The second target, whose points are mapped.")]
    T_from_to: Annotated[
        Matrix, Field(description="4 x 4, mm: maps points of the second target into the first's frame.")
    ]
    covariance: Annotated[
        Matrix,
        Field(
            description="6 x 6: x, y, z (mm), then a small rotation (rad) from the left, in the first target's frame."
        ),
    ]
    image_count: Annotated[int, Field(description="What it was found from: images, poses or pairs of axes.")]
