"""Resolution of an instrument, from its readings: the step of which all of them are multiples.

Readings of a robot that an instrument does not round never tie. Where they do, and all values of an axis are whole
multiples of a step, the step is the resolution. A scatter of several steps is little affected: rounding adds step² / 12
to the variance (Sheppard), as the instrument's own noise would. Below `MIN_STEPS` what is read depends on where the
robot stands between two steps, and no figure of scatter has an interval.

References: W. F. Sheppard, Proc. London Math. Soc. 29 (1898) 353-380, doi:10.1112/plms/s1-29.1.353; ISO 14253-2:2011,
8.4 (resolution as a component of uncertainty).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.metrology.iso9283 import ROUNDING, are_unchanging, deviations

MIN_STEPS = 0.5
"""Standard deviation that is read, in steps, below which intervals do not keep their level."""
MAX_SHARE = 0.1
"""Of the variance of a position: where hidden axes may hold more, its figure has no interval either."""
_PARTS = 10
"""The least gap between two readings is at most so many steps."""
_FIT = 1e-6
_MAX_MISFIT = 1e-2
_EPSILON = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True)
class Resolution:
    """The step of the readings along each axis, mm, 0 where none shows, and the axes whose scatter it hides.

    `hides_position` says that the position's scatter as a whole is hidden.
    """

    step_mm: Float[np.ndarray, "3"]
    hidden: Bool[np.ndarray, "3"]
    hides_position: bool

    @property
    def variance(self) -> Float[np.ndarray, "3"]:
        """What rounding adds to the variance along each axis, mm²."""
        return np.asarray(self.step_mm**2 / 12.0)


def hides_scatter(positions_mm: Float[np.ndarray, "n 3"]) -> bool:
    """Return whether one pose's readings say nothing of its scatter: they do not change, or rounding hides it."""
    if are_unchanging(positions_mm):
        return True
    found = find_resolution(positions_mm)
    return found is not None and found.hides_position


def find_resolution(positions_mm: Float[np.ndarray, "n 3"]) -> Resolution | None:
    """Return the resolution of one pose's readings; None where no step shows that matters for their scatter."""
    about = deviations(positions_mm)
    n = len(about)
    variance = np.einsum("ni,ni->i", about, about) / max(n - 1, 1)
    steps = np.array(
        [_step(values) if s > 0.0 else 0.0 for values, s in zip(positions_mm.T, variance, strict=True)]
    )
    coarsest = float(steps.max())
    if coarsest == 0.0:
        return None
    # An axis of one value alone is hidden if that value has the step of the others.
    still = (variance == 0.0) & _are_multiples(positions_mm[0], coarsest)
    steps = np.where(still, coarsest, steps)
    hidden = (steps > 0.0) & (variance < (MIN_STEPS * steps) ** 2)
    most = np.where(hidden, (MIN_STEPS * steps) ** 2, 0.0).sum()
    return Resolution(steps, hidden, bool(most > MAX_SHARE * variance.sum()))


def _step(values: Float[np.ndarray, " n"]) -> float:
    """Return the step of which all values are multiples; 0 where they do not tie, or are multiples of none."""
    ordered = np.sort(values)
    gaps = np.diff(ordered)
    gaps = gaps[gaps > ROUNDING * np.abs(ordered).max()]
    if len(gaps) == 0 or len(gaps) == len(values) - 1:
        return 0.0
    for parts in range(1, _PARTS + 1):
        step = float(gaps.min()) / parts
        if _are_multiples(values, step).all():
            return step
    return 0.0


def _are_multiples(values: Float[np.ndarray, " n"], step: float) -> Bool[np.ndarray, " n"]:
    """Return which values are whole multiples; none where they are too many steps to see that in a float."""
    counts = values / step
    misfit = _FIT + 8.0 * _EPSILON * float(np.max(counts**2, initial=0.0))
    if misfit > _MAX_MISFIT:
        return np.zeros(len(values), dtype=bool)
    return np.asarray(np.abs(counts - np.round(counts)) <= misfit)
