"""Scores of a series whose mean and standard deviation nobody knows beforehand.

Each value is compared with those before it alone. With mean m and standard deviation s of the n - 1 earlier values,

    t_n = sqrt((n - 1) / n) (x_n - m) / s

has Student's t distribution with n - 2 degrees of freedom, and q_n = Φ⁻¹(F_{n-2}(t_n)), n ≥ 3, are independent and
standard normal where the x are independent and of one normal distribution: exactly, however short the series. A chart
of q_n has its stated false-alarm rate from the third value on, without a phase in which parameters are estimated.

References: Quesenberry, "SPC Q charts for start-up processes and short or long runs", Journal of Quality Technology
23(3), 1991, eq. (9); Hawkins, "Self-starting CUSUM charts for location and scale", The Statistician 36, 1987.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri, ndtri_exp, stdtr

from core.errors import InvalidArgument

FIRST = 2
"""Values that have no score: two are needed before one can be compared with them."""
_NEAR_ZERO = 1e-12


def self_starting_scores(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """Return the score of every value from the third on, m = n - 2 (none for fewer than three values).

    A value that follows equal ones is scored 0 where it is equal too, else as ±8: no scatter is known, and the series
    is not of measured figures. Raises InvalidArgument for values that are not finite.
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
    difference = centred[FIRST:] - mean[before]
    scale = max(float(np.abs(x).max()), 1e-300)
    is_constant = sigma <= _NEAR_ZERO * scale
    t = np.sqrt((n - 1) / n) * difference / np.where(is_constant, 1.0, sigma)
    # The upper tail as the lower one of the negative: 1 - F has no digits left there.
    lower = np.maximum(stdtr(n - 2, -np.abs(t)), 1e-300)
    scores = -np.sign(t) * np.where(lower < 1e-10, ndtri_exp(np.log(lower)), ndtri(lower))
    jumps = np.where(np.abs(difference) <= _NEAR_ZERO * scale, 0.0, np.copysign(8.0, difference))
    return np.asarray(np.where(is_constant, jumps, scores))
