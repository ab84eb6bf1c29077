"""Outliers among the cycles of a pose.

A robot's own outlier is part of its repeatability, so all cycles count. The rule names what no scatter explains: a
cycle farther from the median pose than eight times the distance within which four cycles in five lie, where at most
one cycle in ten (or one) lies so far. More of them are a second cluster: a warning is given. Of Gaussian cycles, even
on a line, the rule names one in 3,000 poses of ten cycles and none in 400,000 poses of thirty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import Advisory

OUTLIER_FACTOR = 8.0
NEAR_SHARE = 0.8
MIN_CYCLES = 10
"""Below this the distance within which most cycles lie is too uncertain to judge by."""


@dataclass(frozen=True, slots=True)
class Outlier:
    """A cycle that no scatter explains.

    Its index in the pose's cycles (from 0), a stable code, its distance from the median position, and why.
    """

    index: int
    code: str
    distance_mm: float
    detail: str


def find_outliers(
    positions_mm: Float[np.ndarray, "n 3"], vectors: Float[np.ndarray, "n 3"] | None = None
) -> tuple[list[Outlier], list[Advisory]]:
    """Return the outliers, and warnings on cycles that are far away and too many to be outliers.

    `vectors` are the rotation vectors about the mean rotation, rad.
    """
    outliers: list[Outlier] = []
    warnings: list[Advisory] = []
    if len(positions_mm) < MIN_CYCLES:
        return outliers, warnings
    distances_mm = _from_median(positions_mm)
    _judge(distances_mm, distances_mm, "position", 1.0, "mm", outliers, warnings)
    if vectors is not None:
        # An outlier shifts the mean rotation; subtracting the median of the vectors corrects it.
        _judge(
            _from_median(vectors),
            distances_mm,
            "orientation",
            float(np.degrees(1.0)),
            "°",
            outliers,
            warnings,
        )
    seen: dict[int, Outlier] = {}
    for outlier in outliers:
        seen.setdefault(outlier.index, outlier)
    return [seen[index] for index in sorted(seen)], warnings


def _from_median(values: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    middle = (len(values) - 1) // 2, len(values) // 2
    median = np.sort(values, axis=0)[middle, :].mean(axis=0)
    return np.asarray(np.linalg.norm(values - median, axis=1))


def _judge(
    distances: Float[np.ndarray, " n"],
    distances_mm: Float[np.ndarray, " n"],
    what: str,
    factor: float,
    unit: str,
    outliers: list[Outlier],
    warnings: list[Advisory],
) -> None:
    typical = float(np.sort(distances)[int(NEAR_SHARE * (len(distances) - 1))])
    far = np.flatnonzero(distances > OUTLIER_FACTOR * typical)
    # Most cycles on one spot: a coarse display, from which nothing can be judged.
    if typical == 0.0 or len(far) == 0:
        return
    if len(far) > max(1, len(distances) // 10):
        warnings.append(
            Advisory(
                f"{what}_clusters",
                f"{len(far)} of {len(distances)} cycles lie more than {OUTLIER_FACTOR:g} times as far out in {what} as "
                f"{NEAR_SHARE:.0%} of them.",
                "Look at the scatter: the robot may stop at two places, or two poses may share one tag. A wrong pose "
                "or cycle of an image can be corrected, and a measurement excluded (PATCH "
                "/v1/measurements/{measurement_id}, `gridpose measurements correct` and `exclude`).",
            )
        )
        return
    for index in far:
        outliers.append(
            Outlier(
                int(index),
                f"{what}_outlier",
                float(distances_mm[index]),
                f"{factor * distances[index]:.4g} {unit} from the median {what}; {NEAR_SHARE:.0%} of the cycles lie "
                f"within {factor * typical:.4g} {unit} of it.",
            )
        )
