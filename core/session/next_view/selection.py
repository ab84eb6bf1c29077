"""The choice of views one after another: the candidate that leaves the smallest tr(G (M + Λ)⁻¹).

M is the information so far, Λ the candidate's, and G weighs what is to become certain.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.errors import InvalidArgument
from core.numerics import covariance_of


def greedy(
    M: Float[np.ndarray, "c c"],
    information: Float[np.ndarray, "n c c"],
    G: Float[np.ndarray, "c c"],
    count: int,
    *,
    repeat: bool = True,
) -> tuple[list[int], list[Float[np.ndarray, "c c"]]]:
    """Return the candidates to take in their order, and the covariance before and after each.

    One may be repeated unless `repeat` is false: then there are no more than candidates.

    Raises InvalidArgument for no candidates to take.
    """
    if count < 1:
        raise InvalidArgument("Ask for one view or more.")
    chosen: list[int] = []
    penalty = np.zeros(len(information))
    left = [covariance_of(M)]
    for _ in range(count if repeat else min(count, len(information))):
        # mm, px and pure numbers: the inverse is of a scaled matrix.
        unit = 1.0 / np.sqrt(np.diag(M))
        scaled = (M + information) * np.outer(unit, unit)
        after = np.linalg.inv(scaled) * np.outer(unit, unit)
        best = int(np.argmin(np.einsum("ncd,cd->n", after, G) + penalty))
        chosen.append(best)
        penalty[best] = 0.0 if repeat else math.inf
        M = M + information[best]
        left.append(after[best])
    return chosen, left
