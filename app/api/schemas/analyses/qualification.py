"""Known lengths, and what they show of a session's camera, lens and target, as JSON."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.analyses.common import (
    AcceptanceDecision,
    EstimatedAnalysis,
    EstimatorField,
    Interval,
    SourceField,
)
from app.api.schemas.common import RequestModel, ResponseModel, Share
from app.api.schemas.fields import PoseId, PoseIdField

Length = Annotated[float, Field(gt=0, le=1e6, description="Calibrated length between the two positions, mm.")]
Uncertainty = Annotated[
    float, Field(ge=0, le=1e6, description="Standard uncertainty of the calibrated length, mm.")
]


class KnownLengthCreate(RequestModel):
    """A calibrated length between two poses: of a stage, a gauge block, or the robot against a standard."""

    from_pose_id: PoseIdField
    to_pose_id: PoseIdField
    length_mm: Length
    standard_uncertainty_mm: Uncertainty


class QualificationCreate(RequestModel):
    """Known lengths that a session measured, and the limit on their errors."""

    lengths: Annotated[
        list[KnownLengthCreate],
        Field(min_length=1, max_length=500, description="Calibrated lengths between poses of the session."),
    ]
    maximum_permissible_error_mm: Annotated[
        Annotated[float, Field(gt=0, le=1e6)] | None,
        Field(description="Limit on every length's error, mm; null: nothing is decided."),
    ] = None
    estimator: EstimatorField = "pooled"
    source: SourceField = "images"


class LengthErrorRead(ResponseModel):
    """One length: what was measured, and its error."""

    from_pose_id: PoseId
    to_pose_id: PoseId
    length_mm: Length
    length_standard_uncertainty_mm: Uncertainty
    measured_mm: Annotated[float, Field(description="Distance of the mean positions, mm.")]
    error_mm: Annotated[float, Field(description="Measured less calibrated, mm.")]
    standard_uncertainty_mm: Annotated[
        float,
        Field(
            description="Of the error, mm: of the calibrated length and of the means, nothing of the instrument."
        ),
    ]
    interval_mm: Annotated[Interval, Field(description="[low, high] of the error, mm.")]


class QualificationAnalysis(EstimatedAnalysis):
    """What known lengths show of a session's camera, lens and target."""

    source: SourceField
    confidence_level: Annotated[
        Share, Field(description="Probability that an interval contains its figure, such as 0.95.")
    ]
    lengths: Annotated[list[LengthErrorRead], Field(description="The lengths in the order given.")]
    worst_error_mm: Annotated[float, Field(description="The error that is largest in size, mm.")]
    maximum_permissible_error_mm: Annotated[float | None, Field(description="The limit as sent, mm.")]
    decision: Annotated[
        AcceptanceDecision | None,
        Field(
            description="`pass`: every interval lies within the limit; `fail`: one lies beyond it, of m lengths "
            "at the m-th part of the risk; null without a "
            "limit."
        ),
    ]
    rule: Annotated[str, Field(description="By which rule it is decided.")]
    probing_scatter_mm: Annotated[
        float | None,
        Field(
            description="Largest distance of a visit from its pose's mean, mm; null: no pose has two visits."
        ),
    ]
    scale_ppm: Annotated[
        float, Field(description="By how much lengths are measured too long, parts in a million.")
    ]
    scale_standard_uncertainty_ppm: Annotated[
        float, Field(description="Standard uncertainty of `scale_ppm`.")
    ]
