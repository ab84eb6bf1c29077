"""Least squares by polynomials in two variables, of no higher a degree than the values call for.

The polynomials come as columns of B = Q R, degree by degree: one of degree 0, two of degree 1, and so on. With Q's
columns orthonormal, what each degree explains stands by itself, qᵀ y, and is compared with what is left over.

Reference: L. Giraud, J. Langou, M. Rozložník, J. van den Eshof, "Rounding error analysis of the classical Gram-Schmidt
orthogonalization process", Numer. Math. 101 (2005) 87-100, 10.1007/s00211-005-0615-4.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.jit import jit

_SIGNIFICANCE = 5.0
"""A degree is used if its terms explain more than mere noise would by so many standard deviations of that."""


@jit("f8[:, ::1]")
def orthonormal(
    B: Float[np.ndarray, "n k"],
) -> tuple[Float[np.ndarray, "n k"], Float[np.ndarray, "k k"]]:
    """Return Q and upper R of B = Q R by Gram's and Schmidt's process, done twice, so that rounding leaves Q orthogonal
    (Giraud et al.); a column that the former ones make up is 0 in Q.
    """
    terms = B.shape[1]
    Q, R = np.ascontiguousarray(B.T), np.zeros((terms, terms))
    for k in range(terms):
        whole = math.sqrt(_product(Q[k], Q[k]))
        for _ in range(2):
            for i in range(k):
                part = _product(Q[i], Q[k])
                R[i, k] += part
                _take_away(Q[k], part, Q[i])
        length = math.sqrt(_product(Q[k], Q[k]))
        if length > 1e-14 * whole:
            R[k, k] = length
            Q[k] /= length
        else:
            Q[k] = 0.0
    return np.ascontiguousarray(Q.T), R


@jit("f8[::1], f8[::1]", reassociates=True)
def _product(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]) -> float:
    """Return a · b."""
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@jit("f8[::1], f8, f8[::1]")
def _take_away(a: Float[np.ndarray, " n"], part: float, b: Float[np.ndarray, " n"]) -> None:
    """Subtract a part of b from a, without the array between that an expression makes."""
    for k in range(len(a)):
        a[k] -= part * b[k]


@jit("f8[:, ::1], f8[:, ::1], f8[:, ::1], i8, i8")
def graded_coefficients(
    Q: Float[np.ndarray, "n k"],
    R: Float[np.ndarray, "k k"],
    y: Float[np.ndarray, "n c"],
    free: int,
    highest: int,
) -> Float[np.ndarray, "t c"]:
    """Return the least-squares coefficients of B = Q R up to the highest degree whose terms explain more than noise.

    `free` is the number of values that count (rows of B that are not 0); no degree above `highest` is tried.
    """
    columns = y.shape[1]
    explained = np.zeros((Q.shape[1], columns))
    left = 0.0
    for n in range(Q.shape[0]):
        for c in range(columns):
            left += y[n, c] ** 2
            for k in range(Q.shape[1]):
                explained[k, c] += Q[n, k] * y[n, c]
    terms = 0
    for degree in range(highest + 1):
        first, last = degree * (degree + 1) // 2, (degree + 1) * (degree + 2) // 2
        gain, least = 0.0, math.inf
        for k in range(first, last):
            least = min(least, abs(R[k, k]))
            for c in range(columns):
                gain += explained[k, c] ** 2
        left -= gain
        if least <= 1e-9 * abs(R[0, 0]):  # too few points, or all on a line
            break
        noise = max(left, 0.0) / max((free - last) * columns, 1)
        values = (last - first) * columns
        if gain > noise * (values + _SIGNIFICANCE * math.sqrt(2.0 * values)):
            terms = last
    solution = explained[:terms].copy()
    for c in range(columns):
        for i in range(terms - 1, -1, -1):
            for k in range(i + 1, terms):
                solution[i, c] -= R[i, k] * solution[k, c]
            solution[i, c] /= R[i, i]
    return solution
