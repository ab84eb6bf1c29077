"""The figures of ISO 9283 for one pose as JSON."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from app.api.schemas.analyses.common import Interval
from app.api.schemas.common import ResponseModel


class RepeatabilityFigures(ResponseModel):
    """Pose repeatability by ISO 9283:1998, 7.2.2; null where it is not known."""

    rp_l_mm: Annotated[
        float | None,
        Field(
            description="Position: RP_l = mean distance from the mean position + 3 S of the distances, mm."
        ),
    ]
    rp_x_mm: Annotated[float | None, Field(description="3 S along the target frame's x, mm.")]
    rp_y_mm: Annotated[float | None, Field(description="3 S along the target frame's y, mm.")]
    rp_z_mm: Annotated[float | None, Field(description="3 S along the target frame's z, mm.")]
    rp_roll_deg: Annotated[float | None, Field(description="3 S of the roll angle, degrees.")]
    rp_pitch_deg: Annotated[float | None, Field(description="3 S of the pitch angle, degrees.")]
    rp_yaw_deg: Annotated[float | None, Field(description="3 S of the yaw angle, degrees.")]


class RepeatabilityIntervals(ResponseModel):
    """For each figure [low, high], between which it lies at the confidence level."""

    rp_l_mm: Annotated[
        Interval | None,
        Field(description="[low, high] of RP_l of the position, mm."),
    ]
    rp_x_mm: Annotated[
        Interval | None, Field(description="[low, high] of 3 S along the target frame's x, mm.")
    ]
    rp_y_mm: Annotated[
        Interval | None, Field(description="[low, high] of 3 S along the target frame's y, mm.")
    ]
    rp_z_mm: Annotated[
        Interval | None, Field(description="[low, high] of 3 S along the target frame's z, mm.")
    ]
    rp_roll_deg: Annotated[
        Interval | None, Field(description="[low, high] of 3 S of the roll angle, degrees.")
    ]
    rp_pitch_deg: Annotated[
        Interval | None, Field(description="[low, high] of 3 S of the pitch angle, degrees.")
    ]
    rp_yaw_deg: Annotated[Interval | None, Field(description="[low, high] of 3 S of the yaw angle, degrees.")]


class AccuracyFigures(ResponseModel):
    """Pose accuracy by ISO 9283:1998, 7.2.1; null where it is not known."""

    ap_p_mm: Annotated[
        float | None,
        Field(description="Position: distance of the attained mean from the commanded position, mm."),
    ]
    ap_x_mm: Annotated[
        float | None, Field(description="Attained less commanded along the base frame's x, mm.")
    ]
    ap_y_mm: Annotated[
        float | None, Field(description="Attained less commanded along the base frame's y, mm.")
    ]
    ap_z_mm: Annotated[
        float | None, Field(description="Attained less commanded along the base frame's z, mm.")
    ]
    ap_roll_deg: Annotated[float | None, Field(description="Attained less commanded roll angle, degrees.")]
    ap_pitch_deg: Annotated[float | None, Field(description="Attained less commanded pitch angle, degrees.")]
    ap_yaw_deg: Annotated[float | None, Field(description="Attained less commanded yaw angle, degrees.")]


class VariationFigures(ResponseModel):
    """Multi-directional pose accuracy variation by ISO 9283:1998, 7.2.3; null where it is not known."""

    vap_p_mm: Annotated[
        float | None,
        Field(description="Position: largest distance between two directions' mean positions, mm."),
    ]
    vap_x_mm: Annotated[
        float | None, Field(description="Largest difference of two directions' means along x, mm.")
    ]
    vap_y_mm: Annotated[
        float | None, Field(description="Largest difference of two directions' means along y, mm.")
    ]
    vap_z_mm: Annotated[
        float | None, Field(description="Largest difference of two directions' means along z, mm.")
    ]
    vap_roll_deg: Annotated[float | None, Field(description="Largest difference of the roll angle, degrees.")]
    vap_pitch_deg: Annotated[
        float | None, Field(description="Largest difference of the pitch angle, degrees.")
    ]
    vap_yaw_deg: Annotated[float | None, Field(description="Largest difference of the yaw angle, degrees.")]
