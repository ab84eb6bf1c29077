"""What is said of a measurement whose image was stated to show another target, which its session has no more."""

from __future__ import annotations

from typing import Any

Columns = dict[str, Any]


def with_warning(columns: Columns | None, stated: str | None, target_id: str | None) -> Columns | None:
    """Return the columns of a result of `target_id`, with a warning where the upload stated another target."""
    if columns is None or stated is None or target_id is None or stated == target_id:
        return columns
    warning = _warning(
        code="stated_target_removed",
        detail=f"The image was sent as one of target {stated}, which was taken out of the session.",
        advice="Add that target to the session's target_ids again, and the image is searched for it alone. Exclude the "
        "measurement if it is not to count.",
    )
    calibration = columns["calibration"]
    if calibration is not None:
        calibration = {**calibration, "warnings": [*calibration["warnings"], warning]}
    return {
        **columns,
        "calibration": calibration,
        "points_warnings": [*(columns["points_warnings"] or ()), warning],
    }


def _warning(*, code: str, detail: str, advice: str) -> dict[str, str]:
    """Return a warning as the API shows it; the numerics' own class would load the numerics."""
    return {"code": code, "detail": detail, "advice": advice}
