"""Least median of residuals: what a few points say that most of the others agree with.

Closed forms believe every point. Where some may be wrong, the closed form of many small sets of points is tried, and
the set kept whose residuals over all points have the least median.

References: P. J. Rousseeuw, "Least median of squares regression", J. American Statistical Association 79 (1984)
871-880, 10.1080/01621459.1984.10477105.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

_SMALLEST = 1e-12


def best_subset(
    lengths_of: Callable[[Int[np.ndarray, "s k"]], Float[np.ndarray, "s q n"]],
    of_all: Float[np.ndarray, "q n"],
    *,
    size: int,
    number: int,
) -> Int[np.ndarray, " k"] | None:
    """Return the set of `size` points whose closed form leaves the least median residuals, or None where that of all
    points does.

    Parameters
    ----------
    lengths_of
        The closed forms of sets of points, as the lengths of all n points' residuals, of each of q kinds; infinite for
        a set without a closed form.
    of_all
        The lengths that the closed form of all points leaves. Medians are compared with theirs, kind by kind, and the
        mean over the kinds of the ratio counts.
    number
        How many sets are tried, the same ones every time.
    """
    kinds, count = of_all.shape
    rng = np.random.default_rng(0)
    sets = np.array([np.sort(rng.permutation(count)[:size]) for _ in range(number)])
    typical = np.maximum(np.median(of_all, axis=1), _SMALLEST)
    scores = np.sum(np.median(lengths_of(sets), axis=2) / typical, axis=1)
    best = int(np.argmin(scores))
    return sets[best] if scores[best] < kinds else None
