"""Scores of a series whose mean and standard deviation nobody knows beforehand.

Each value is compared with those before it alone. With mean m and standard deviation s of the n - 1 earlier values,

    t_n = sqrt((n - 1) / n) (x_n - m) / s

has Student's t distribution with n - 2 degrees of freedom, and q_n = Φ⁻¹(F_{n-2}(t_n)), n ≥ 3, are independent and
standard normal where the x are independent and of one normal distribution: exactly, however short the series. A chart
of q_n has its stated false-alarm rate from the third value on, without a phase in which parameters are estimated.

Rounded values may be equal, and a few equal ones show less scatter than there is. With δ the smallest step between two
of the n values, s is taken as δ/√12 at least: what rounding to steps of δ adds. Values that all differ have s ≥ δ/√2,
and are scored as before.

References: Quesenberry, "SPC Q charts for start-up processes and short or long runs", Journal of Quality Technology
23(3), 1991, eq. (9); Hawkins, "Self-starting CUSUM charts for location and scale", The Statistician 36, 1987; JCGM
100:2008, F.2.2.1 (resolution).
"""

from __future__ import annotations

import math
from bisect import bisect

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri, ndtri_exp, stdtr

from core.errors import InvalidArgument

FIRST = 2
"""Values that have no score: two are needed before one can be compared with them."""
ROUNDING = 1.0 / math.sqrt(12.0)
"""Standard deviation of what rounding to steps of 1 adds."""
_NEAR_ZERO = 1e-12
"""Share of a value below which a difference is that of adding numbers."""


def self_starting_scores(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """Return the score of every value from the third on, m = n - 2 (none for fewer than three values).

    A value that equals all before it is scored 0. Raises InvalidArgument for values that are not finite.
    """
    x = np.asarray(values, float)
    if not np.isfinite(x).all():
        raise InvalidArgument("A chart takes finite values alone.")
    if len(x) <= FIRST:
        return np.zeros(0)
    count = np.arange(1, len(x) + 1)
    centred = x - x[0]  # so that the sums below lose no digits
    mean = np.cumsum(centred) / count
    squares = np.cumsum(centred**2) - count * mean**2
    before = slice(FIRST - 1, -1)
    n = count[FIRST:]
    sigma = np.sqrt(np.maximum(squares[before], 0.0) / (n - 2))
    sigma = np.maximum(sigma, ROUNDING * smallest_steps(x)[FIRST:])
    t = np.sqrt((n - 1) / n) * (centred[FIRST:] - mean[before]) / sigma
    # The upper tail as the lower one of the negative: 1 - F has no digits left there.
    lower = np.maximum(stdtr(n - 2, -np.abs(t)), 1e-300)
    return np.asarray(-np.sign(t) * np.where(lower < 1e-10, ndtri_exp(np.log(lower)), ndtri(lower)))


def smallest_steps(x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the smallest difference between unequal values among the first n, for each n; infinite without any."""
    smallest, steps, ordered = math.inf, np.empty(len(x)), list[float]()
    for k, value in enumerate(x.tolist()):
        place = bisect(ordered, value)
        for other in ordered[max(place - 1, 0) : place + 1]:
            step = abs(value - other)
            if step > _NEAR_ZERO * abs(value):
                smallest = min(smallest, step)
        ordered.insert(place, value)
        steps[k] = smallest
    return steps
