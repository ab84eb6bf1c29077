"""Cycles that do not belong to the rest: few, far away, and named.

A robot's own outlier is part of its repeatability, so the rule takes out only what no scatter explains: a cycle
farther from the median pose than eight times the distance within which four cycles in five lie, where at most one
cycle in ten (or one) lies so far. More of them are a second cluster, which the robot may well have made: they stay,
and a remark says so. Of Gaussian cycles, even on a line, the rule takes one in 3,000 poses of ten cycles and none in
400,000 poses of thirty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import Advisory

FAR = 8.0
NEAR_SHARE = 0.8
MINIMUM_CYCLES = 10
"""Below this the distance within which most cycles lie is too uncertain to judge by."""


@dataclass(frozen=True, slots=True)
class Exclusion:
    """A cycle left out of the figures: its index in the pose's cycles (from 0), a stable code, and why."""

    index: int
    code: str
    detail: str


def find_outliers(
    positions_mm: Float[np.ndarray, "n 3"], vectors: Float[np.ndarray, "n 3"] | None = None
) -> tuple[list[Exclusion], list[Advisory]]:
    """Return the cycles that belong to something else, and remarks on those that look so and stay.

    `vectors` are the rotation vectors about the mean rotation, rad.
    """
    exclusions: list[Exclusion] = []
    remarks: list[Advisory] = []
    if len(positions_mm) < MINIMUM_CYCLES:
        return exclusions, remarks
    _judge(_from_median(positions_mm), "position", 1.0, "mm", exclusions, remarks)
    if vectors is not None:
        # An outlier draws the mean rotation; the median of the vectors takes that back.
        _judge(_from_median(vectors), "orientation", float(np.degrees(1.0)), "°", exclusions, remarks)
    seen: dict[int, Exclusion] = {}
    for exclusion in exclusions:
        seen.setdefault(exclusion.index, exclusion)
    return [seen[index] for index in sorted(seen)], remarks


def _from_median(values: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    middle = (len(values) - 1) // 2, len(values) // 2
    median = np.sort(values, axis=0)[middle, :].mean(axis=0)
    return np.asarray(np.linalg.norm(values - median, axis=1))


def _judge(
    distances: Float[np.ndarray, " n"],
    what: str,
    factor: float,
    unit: str,
    exclusions: list[Exclusion],
    remarks: list[Advisory],
) -> None:
    typical = float(np.sort(distances)[int(NEAR_SHARE * (len(distances) - 1))])
    far = np.flatnonzero(distances > FAR * typical)
    # Most cycles on one spot: a coarse display, from which nothing can be judged.
    if typical == 0.0 or len(far) == 0:
        return
    if len(far) > max(1, len(distances) // 10):
        remarks.append(
            Advisory(
                f"{what}_clusters",
                f"{len(far)} of {len(distances)} cycles lie more than {FAR:g} times as far out in {what} as "
                f"{NEAR_SHARE:.0%} of them; they are counted.",
                "Look at the scatter: the robot may stop at two places, or two poses may share one tag.",
            )
        )
        return
    for index in far:
        exclusions.append(
            Exclusion(
                int(index),
                f"{what}_outlier",
                f"{factor * distances[index]:.4g} {unit} from the median {what}; {NEAR_SHARE:.0%} of the cycles lie "
                f"within {factor * typical:.4g} {unit} of it.",
            )
        )
