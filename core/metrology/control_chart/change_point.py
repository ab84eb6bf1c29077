"""A step between two levels in a series whose levels and scatter nobody knows beforehand.

A score of `self_starting` compares a value with all before it. After a step early in the series these are of both
levels, and the scatter that they show is the step itself: the scores stay small, however large the step is. The
two-sample test takes all n values so far instead, split after each k-th one:

    t_k = sqrt(k (n - k) / n) (mean of the others - mean of the first k) / s,

with s² the pooled variance, has Student's t distribution with n - 2 degrees of freedom where nothing changed. Of all
splits the largest |t_k| counts; its chance times the number of splits (Bonferroni) makes false alarms at most as
frequent as stated. Each part has two values at least: a single one that stands out is no other level. Of rounded
values s is what rounding adds at least, as in `self_starting`.

Reference: Hawkins, Qiu and Kang, "The changepoint model for statistical process control", Journal of Quality
Technology 35(4), 2003, section "The changepoint model".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import stdtr

from core.metrology.control_chart.self_starting import ROUNDING, smallest_steps

MIN_PART = 2
"""Values on either side of a step."""


@dataclass(frozen=True, slots=True)
class Step:
    """The point at which another level was shown first, and which way it went."""

    at: int
    is_up: bool


def first_step(values: Float[np.ndarray, " n"], risk: float) -> Step | None:
    """Return the first step that a series shows, None where it shows none.

    `risk` is the largest chance of a false alarm at each point.
    """
    x = np.asarray(values, float)
    centred = x - x[:1]  # so that the sums below lose no digits
    sums, squares = np.cumsum(centred), np.cumsum(centred**2)
    least = (ROUNDING * smallest_steps(x)) ** 2
    for n in range(2 * MIN_PART, len(x) + 1):
        k = np.arange(MIN_PART, n - MIN_PART + 1)
        mean = sums[n - 1] / n
        below = k * mean - sums[k - 1]  # of the first k, by how much their sum is below k means
        between = below**2 * n / (k * (n - k))
        best = int(np.argmax(between))
        within = float(squares[n - 1] - n * mean**2 - between[best])
        t = math.sqrt(float(between[best]) / max(within / (n - 2), float(least[n - 1])))
        if 2.0 * len(k) * float(stdtr(n - 2, -t)) <= risk:
            return Step(n - 1, is_up=bool(below[best] > 0.0))
    return None
