"""From refined corners to a target's grid points: those that can be trusted, and what is said of the others."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8, UInt16

from core.errors import Advisory
from core.targets.specification import GridPoints, Labelling, TargetSpec, missing_points_warning
from core.targets.subpixel import RefinedCorners


def measured_points(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"],
    target: TargetSpec,
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    refined: RefinedCorners,
    trusted: Bool[np.ndarray, " n"],
    missing_reason: str,
    *,
    warnings: tuple[Advisory, ...] = (),
    labelling: Labelling = "absolute",
    markers_px: Mapping[int, Float[np.ndarray, "4 2"]] | None = None,
) -> GridPoints:
    """Return the trusted ones of a target's refined corners; `missing_reason` states why others are missing.

    `column` and `row` are the corners' in the target; the rest is as in `GridPoints`.
    """
    missing = target.size - int(trusted.sum())
    if missing:
        warnings = (*warnings, missing_points_warning(missing, target.size, missing_reason))
    return GridPoints(
        target=target,
        image_width_px=image.shape[1],
        image_height_px=image.shape[0],
        column=column[trusted],
        row=row[trusted],
        points_px=np.ascontiguousarray(refined.points_px[trusted]),
        standard_uncertainty_px=refined.standard_uncertainty_px[trusted],
        warnings=warnings,
        markers_px=markers_px,
        labelling=labelling,
    )
