"""Inverses and roots of covariances whose parameters differ in unit by orders of magnitude."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def inverse(information: Float[np.ndarray, "q q"]) -> Float[np.ndarray, "q q"]:
    unit = 1.0 / np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information * np.outer(unit, unit))
    return np.asarray(0.5 * (inverse + inverse.T) * np.outer(unit, unit))


def root(covariance: Float[np.ndarray, "q q"]) -> Float[np.ndarray, "q q"]:
    """Return B with B Bᵀ = Σ, by eigenvectors of the correlations."""
    unit = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    return np.asarray(unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def compressed(common: Float[np.ndarray, "m 6 e"]) -> Float[np.ndarray, "m 6 d"]:
    """Return as many columns as there are rows, where there are more, with the same covariances."""
    m, _, count = common.shape
    if count <= 6 * m:
        return common
    R = np.linalg.qr(common.reshape(6 * m, count).T, mode="r")
    return np.ascontiguousarray(np.asarray(R).T.reshape(m, 6, -1))
