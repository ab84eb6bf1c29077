"""Inverses and roots of covariances whose parameters differ in unit by orders of magnitude."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular

ROUNDING = 1e-13
"""Of a unit diagonal: what rounding may take from a parameter of which the data say nothing."""


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


def compressed(common: Float[np.ndarray, "m 6 e"]) -> Float[np.ndarray, "m 6 d"]:
    """Return as many columns as there are rows, where there are more, with the same covariances."""
    m, _, count = common.shape
    if count <= 6 * m:
        return common
    R = np.linalg.qr(common.reshape(6 * m, count).T, mode="r")
    return np.ascontiguousarray(np.asarray(R).T.reshape(m, 6, -1))


def compressed_by_source(
    common: Float[np.ndarray, "m 6 e"], sources: Sequence[str]
) -> tuple[Float[np.ndarray, "m 6 d"], tuple[str, ...]]:
    """Return the columns of every source compressed, and the source of each."""
    of = np.array(sources)
    blocks = {source: compressed(common[:, :, of == source]) for source in dict.fromkeys(sources)}
    kept = tuple(source for source, block in blocks.items() for _ in range(block.shape[2]))
    return np.concatenate(list(blocks.values()), axis=2), kept
