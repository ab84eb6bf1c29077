"""Normal equations of least squares: a damped step, the inverse, its root and the condition number.

All scale the matrix to unit diagonal, so that pixels, millimetres and radians have equal weight.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.jit import jit


@jit("f8[:, ::1], f8[::1], f8")
def damped_step(
    H: Float[np.ndarray, "p p"], g: Float[np.ndarray, " p"], damping: float
) -> tuple[Float[np.ndarray, " p"], float]:
    """Solve (H/(d dᵀ) + damping·I) (d x) = g/d with d² the diagonal of H, by Cholesky's factorisation.

    Returns x and its length in units of its own standard uncertainty, √(xᵀ H x); that is ∞ where H is not positive
    definite.
    """
    size = len(g)
    x = np.zeros(size)
    unit = np.empty(size)
    for i in range(size):
        if not 0.0 < H[i, i] < np.inf:
            return x, np.inf
        unit[i] = 1.0 / np.sqrt(H[i, i])
    L = np.empty((size, size))
    for i in range(size):
        for j in range(i + 1):
            total = H[i, j] * unit[i] * unit[j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            else:
                total += damping
                if not total > 0.0:
                    return x, np.inf
                L[i, i] = np.sqrt(total)
    y = np.empty(size)
    square = 0.0
    for i in range(size):
        total = g[i] * unit[i]
        for k in range(i):
            total -= L[i, k] * y[k]
        y[i] = total / L[i, i]
        square += y[i] * y[i]
    for i in range(size - 1, -1, -1):
        total = y[i]
        for k in range(i + 1, size):
            total -= L[k, i] * x[k]
        x[i] = total / L[i, i]
        square -= damping * x[i] * x[i]
    return x * unit, np.sqrt(max(square, 0.0))


def inverse(matrix: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """Return the inverse of a symmetric matrix; NaN where it is singular."""
    try:
        found = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)
    return np.asarray(0.5 * (found + found.T))


def condition_number(matrix: Float[np.ndarray, "p p"]) -> float:
    """Return the condition number of a positive definite matrix scaled to unit diagonal; ∞ where it is not."""
    diagonal = np.sqrt(np.abs(matrix.diagonal()))
    if not (np.all(diagonal > 0) and math.isfinite(float(diagonal.sum()))):
        return math.inf
    values = np.linalg.eigvalsh(matrix / np.outer(diagonal, diagonal))
    return float(values[-1] / values[0]) if values[0] > 1e-15 * values[-1] else math.inf


def scaled_inverse(H: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """Return the inverse of a positive definite matrix, taken with unit diagonal. Raises LinAlgError."""
    unit = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-300))
    scales = np.outer(unit, unit)
    return np.asarray(np.linalg.inv(H * scales) * scales)


def root_of_inverse(H: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """Return R with R Rᵀ = H⁻¹ of an information matrix; what H does not determine gets a huge variance."""
    unit = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-300))
    values, vectors = np.linalg.eigh(H * np.outer(unit, unit))
    return np.asarray(unit[:, None] * vectors / np.sqrt(np.maximum(values, 1e-15 * values[-1])))


def covariance_of(H: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """Return the inverse of an information matrix, by `root_of_inverse`."""
    R = root_of_inverse(H)
    return np.asarray(R @ R.T)
