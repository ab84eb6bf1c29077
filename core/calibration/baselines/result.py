"""What every method of the comparison hands back, so that its row can stand beside the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.result import Reprojection
from core.calibration.uncertainty import reprojection
from core.camera import Camera
from core.errors import Advisory


@dataclass(frozen=True, slots=True)
class Baseline:
    """The answer of one method, for the views it was given, in their order.

    `camera` is None, and `T_camera_target` empty, where the method maps points without telling a camera. `residuals_px`
    are observed - predicted by the method's own mapping, one array a view; `reprojection` sums up all of them: none of
    these methods rejects points.
    """

    method: str
    camera: Camera | None
    T_camera_target: tuple[Float[np.ndarray, "4 4"], ...]
    residuals_px: tuple[Float[np.ndarray, "_ 2"], ...]
    reprojection: Reprojection
    warnings: tuple[Advisory, ...] = ()


def baseline(
    method: str,
    camera: Camera | None,
    T_camera_target: Sequence[Float[np.ndarray, "4 4"]],
    residuals_px: Sequence[Float[np.ndarray, "_ 2"]],
    warnings: Sequence[Advisory] = (),
) -> Baseline:
    """Sum up the residuals and return the row."""
    together = np.concatenate(list(residuals_px))
    used: Bool[np.ndarray, " n"] = np.ones(len(together), dtype=bool)
    statistics = reprojection(together, used)
    return Baseline(method, camera, tuple(T_camera_target), tuple(residuals_px), statistics, tuple(warnings))
