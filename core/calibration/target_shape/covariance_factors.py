"""Inverses and roots of covariances whose parameters differ in unit by orders of magnitude."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular

ROUNDING = 1e-13
"""Of a unit diagonal: what rounding may take from a parameter of which the data say nothing."""
LEAST_EFFECT = 0.03
"""Of the poses' own errors: errors in common that are smaller change no variance by a thousandth. Of 273 columns that a
print of 126 points makes, two dozen are left."""


def inverse(information: Float[np.ndarray, "q q"]) -> Float[np.ndarray, "q q"]:
    unit = 1.0 / np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information * np.outer(unit, unit))
    return np.asarray(0.5 * (inverse + inverse.T) * np.outer(unit, unit))


def triangular_root(information: Float[np.ndarray, "q q"]) -> Float[np.ndarray, "q q"]:
    """Return upper triangular B with B Bᵀ = Σ, the inverse of the information.

    Column j is what parameter j leaves open where those behind it are known, and how those before it follow.
    """
    unit = 1.0 / np.sqrt(np.diag(information))
    lower = np.linalg.cholesky(information * np.outer(unit, unit) + ROUNDING * np.eye(len(unit)))
    return np.asarray(unit[:, None] * solve_triangular(lower.T, np.eye(len(unit)), lower=False))


def compressed(
    common: Float[np.ndarray, "m 6 e"], whitener: Float[np.ndarray, "m 6 6"]
) -> Float[np.ndarray, "m 6 d"]:
    """Return factors of the same covariances in as few columns as matter, one at least.

    What is missing is less than `LEAST_EFFECT` of the poses' own errors, whose inverse root the `whitener` is, in all
    poses together.
    """
    m, _, count = common.shape
    if not count:
        return common
    tall = (whitener @ common).reshape(6 * m, count)
    squares, turned = np.linalg.eigh(tall.T @ tall)
    matters = squares >= LEAST_EFFECT**2
    matters[-1] = True
    return np.ascontiguousarray(
        (common.reshape(6 * m, count) @ turned[:, matters][:, ::-1]).reshape(m, 6, -1)
    )


def compressed_by_source(
    common: Float[np.ndarray, "m 6 e"], sources: Sequence[str], whitener: Float[np.ndarray, "m 6 6"]
) -> tuple[Float[np.ndarray, "m 6 d"], tuple[str, ...]]:
    """Return the columns of every source compressed, and the source of each."""
    of = np.array(sources)
    blocks = {source: compressed(common[:, :, of == source], whitener) for source in dict.fromkeys(sources)}
    kept = tuple(source for source, block in blocks.items() for _ in range(block.shape[2]))
    return np.concatenate(list(blocks.values()), axis=2), kept
