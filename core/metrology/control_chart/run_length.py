"""Average run length of a two-sided EWMA of independent standard normal scores, from its integral equation.

    z_t = (1 - λ) z_{t-1} + λ q_t,     z_0 = 0,     alarm where |z_t| > h = L sqrt(λ / (2 - λ))

With ARL(z) the mean number of scores until an alarm from the value z, and scores of mean δ and variance 1,

    ARL(z) = 1 + 1/λ ∫_{-h}^{h} ARL(y) φ((y - (1 - λ) z) / λ - δ) dy,

a Fredholm equation of the second kind, which Gauss-Legendre nodes turn into linear equations (Nyström's method).

References: Crowder, "A simple method for studying run-length distributions of exponentially weighted moving average
charts", Technometrics 29(4), 1987, eq. (2); Lucas and Saccucci, "Exponentially weighted moving average control
schemes: properties and enhancements", Technometrics 32(1), 1990, table 3 (values of L).
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from scipy.special import roots_legendre

from core.errors import InvalidArgument

_NODES = 96
"""Enough for ten digits at λ = 0.05: the kernel's width is λ, the interval's about sqrt(λ)."""
MIN_SMOOTHING = 0.05
_MAX_LIMIT = 8.0


def ewma_run_length(smoothing: float, limit: float, shift: float = 0.0) -> float:
    """Return the mean number of scores until an alarm, from a start at zero.

    Parameters
    ----------
    smoothing: λ, from `MIN_SMOOTHING` to 1.
    limit: L, in standard deviations of the EWMA in the long run, above 0.
    shift: δ, mean of the scores; 0 gives the run length between false alarms.

    Raises InvalidArgument for values out of range.
    """
    if not (MIN_SMOOTHING <= smoothing <= 1.0 and 0.0 < limit <= _MAX_LIMIT and math.isfinite(shift)):
        raise InvalidArgument(
            f"No run length of an EWMA with smoothing {smoothing}, limit {limit} and shift {shift}.",
            f"Smoothing is from {MIN_SMOOTHING} to 1, the limit above 0 and at most {_MAX_LIMIT}.",
        )
    h = limit * math.sqrt(smoothing / (2.0 - smoothing))
    nodes, weights = roots_legendre(_NODES)
    y, w = h * nodes, h * weights

    def kernel(z: np.ndarray) -> np.ndarray:
        scores = (y[None, :] - (1.0 - smoothing) * z[:, None]) / smoothing - shift
        density = np.exp(-0.5 * scores**2) / (smoothing * math.sqrt(2.0 * math.pi))
        return np.asarray(density * w[None, :])

    at_nodes = np.linalg.solve(np.eye(_NODES) - kernel(y), np.ones(_NODES))
    return float(1.0 + (kernel(np.zeros(1)) @ at_nodes)[0])


@cache
def ewma_limit(smoothing: float, run_length: float) -> float:
    """Return the limit L at which false alarms are `run_length` scores apart in the mean.

    Raises InvalidArgument for values out of range.
    """
    if not 2.0 <= run_length <= 1e6:
        raise InvalidArgument(
            f"No limit for false alarms that are {run_length} apart.", "Ask for 2 to a million."
        )
    from scipy.optimize import brentq  # takes a tenth of a second to load, and few processes draw charts

    return float(brentq(lambda limit: ewma_run_length(smoothing, limit) - run_length, 0.1, 6.0, xtol=1e-9))
