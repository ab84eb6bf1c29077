"""Outliers among the cycles of a pose.

A robot's own outlier is part of its repeatability, so all cycles count. The rule names what no scatter explains. In
the order of their distances from the median pose, cycle r from outside is compared with the n - r nearer ones, of mean
m and scatter S:

    |x_r - m|² > t² tr(S) (1 + 1 / (n - r)),      t at n - r - 1 degrees of freedom, a chance of `MAX_CHANCE` per pose.

Of cycles on a line this is the test of a single outlier, of all others it is more cautious. The outermost r for which
it holds are outliers, where in addition they lie `MIN_GAP` times as far out as the others: heavy tails have far cycles,
but seldom such a gap. So several outliers do not hide one another. Two and more that are over a tenth of the cycles
are a second cluster: a warning names them, and the pose is not steady.

Reference: B. Rosner, Technometrics 25 (1983) 165-172, 10.1080/00401706.1983.10487848 (several outliers on a line).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from core.errors import Advisory, listed

MAX_CHANCE = 1e-3
MIN_GAP = 3.0
MAX_SHARE = 0.2
"""Of the cycles that are compared with the nearer ones."""
CLUSTERS = ("position_clusters", "orientation_clusters")
MIN_CYCLES = 10
"""Below this the scatter of the nearer cycles is too uncertain to judge by."""


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
    deviations = _from_median(positions_mm)
    distances_mm = np.linalg.norm(deviations, axis=1)
    _judge(deviations, distances_mm, "position", 1.0, "mm", outliers, warnings)
    if vectors is not None:
        # An outlier shifts the mean rotation; subtracting the median of the vectors corrects it.
        degrees = float(np.degrees(1.0))
        _judge(_from_median(vectors), distances_mm, "orientation", degrees, "°", outliers, warnings)
    seen: dict[int, Outlier] = {}
    for outlier in outliers:
        seen.setdefault(outlier.index, outlier)
    return [seen[index] for index in sorted(seen)], warnings


def _from_median(values: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    middle = (len(values) - 1) // 2, len(values) // 2
    return np.asarray(values - np.sort(values, axis=0)[middle, :].mean(axis=0))


def _count_far(deviations: Float[np.ndarray, "n 3"], distances: Float[np.ndarray, " n"]) -> int:
    """Return how many of the outermost cycles the others do not explain; deviations are in the order of distances."""
    tried = int(MAX_SHARE * len(distances))
    if distances[tried] == 0.0:
        return 0  # most cycles on one spot: a coarse display, from which nothing can be judged
    nearer = np.column_stack([deviations, distances**2])[::-1].cumsum(axis=0)[::-1][1 : tried + 1]
    counts = np.arange(len(distances) - 1, len(distances) - 1 - tried, -1)
    means = nearer[:, :3] / counts[:, None]
    scatter = (nearer[:, 3] / counts - np.sum(means**2, axis=1)) * (counts + 1) / (counts - 1)
    squares = np.sum((deviations[:tried] - means) ** 2, axis=1)
    unexplained = squares > stdtrit(counts - 1, 1.0 - 0.5 * MAX_CHANCE / (counts + 1)) ** 2 * scatter
    apart = distances[:tried] > MIN_GAP * distances[1 : tried + 1]
    return int(np.max(np.flatnonzero(unexplained & apart) + 1, initial=0))


def _judge(
    deviations: Float[np.ndarray, "n 3"],
    distances_mm: Float[np.ndarray, " n"],
    what: str,
    factor: float,
    unit: str,
    outliers: list[Outlier],
    warnings: list[Advisory],
) -> None:
    distances = np.linalg.norm(deviations, axis=1)
    order = np.argsort(-distances, kind="stable")
    count = _count_far(deviations[order], distances[order])
    if count > max(1, len(distances) // 10):
        named = listed(str(index + 1) for index in sorted(order[:count].tolist()))
        warnings.append(
            Advisory(
                f"{what}_clusters",
                f"{count} of {len(distances)} cycles ({named} in their order) lie more than {MIN_GAP:g} times as far "
                f"out in {what} as the others. That is no scatter of one process: the pose is not steady.",
                "Look at the scatter: the robot may stop at two places, or two poses may share one tag. A wrong pose "
                "or cycle of an image can be corrected, and a measurement excluded (PATCH "
                "/v1/measurements/{measurement_id}, `gridpose measurements correct` and `exclude`).",
            )
        )
        return
    for index in order[:count]:
        outliers.append(
            Outlier(
                int(index),
                f"{what}_outlier",
                float(distances_mm[index]),
                f"{factor * distances[index]:.4g} {unit} from the median {what}; the others lie within "
                f"{factor * distances[order[count]]:.4g} {unit} of it.",
            )
        )
