"""Long-run RP_l of many covariances at once: what bias correction by replicates spends its time on.

The mean length is a multiple of Carlson's R_G (`mean_length`). With m between a and c,

    2 R_G(a, c, m) = m R_F(a, c, m) + (a - m)(m - c) R_D(a, c, m) / 3 + √(a c / m)

is a sum of positive terms, and both integrals follow from one sequence of duplications.

References: B. C. Carlson, Numerical Algorithms 10 (1995) 13-26, 10.1007/BF02198293; NIST Digital Library of
Mathematical Functions, 19.21.10.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.jit import jit

_LEAST_VARIANCE = 1e-200
_NEEDLE = 1e-30  # of the largest eigenvalue: what the others add to R_G(1, 0, 0) = ½ is rounded away
_SERIES_RANGE = (2.0**-52 / 4.0) ** (-1.0 / 6.0)  # where the series of both integrals are exact to rounding


@jit("f8[:, :, ::1], f8[:, :, ::1], f8[:, :, ::1]")
def replica_readings(
    roots: Float[np.ndarray, "k 3 3"], factors: Float[np.ndarray, "b 3 3"], noise: Float[np.ndarray, "k 3 3"]
) -> Float[np.ndarray, "k b"]:
    """Return g(B Bᵀ - M) with B each root times each factor and M the root's noise, as `long_run_rp` of `eigenvalues`.

    Eigenvalues are those of the closed form by Smith (1961).
    """
    found = np.empty((len(roots), len(factors)))
    B = np.empty((3, 3))
    for k in range(len(roots)):
        for b in range(len(factors)):
            for i in range(3):
                for j in range(3):
                    B[i, j] = (
                        roots[k, i, 0] * factors[b, 0, j]
                        + roots[k, i, 1] * factors[b, 1, j]
                        + roots[k, i, 2] * factors[b, 2, j]
                    )
            xx = B[0, 0] * B[0, 0] + B[0, 1] * B[0, 1] + B[0, 2] * B[0, 2] - noise[k, 0, 0]
            yy = B[1, 0] * B[1, 0] + B[1, 1] * B[1, 1] + B[1, 2] * B[1, 2] - noise[k, 1, 1]
            zz = B[2, 0] * B[2, 0] + B[2, 1] * B[2, 1] + B[2, 2] * B[2, 2] - noise[k, 2, 2]
            xy = B[0, 0] * B[1, 0] + B[0, 1] * B[1, 1] + B[0, 2] * B[1, 2] - noise[k, 0, 1]
            xz = B[0, 0] * B[2, 0] + B[0, 1] * B[2, 1] + B[0, 2] * B[2, 2] - noise[k, 0, 2]
            yz = B[1, 0] * B[2, 0] + B[1, 1] * B[2, 1] + B[1, 2] * B[2, 2] - noise[k, 1, 2]
            mean = (xx + yy + zz) / 3.0
            xx, yy, zz = xx - mean, yy - mean, zz - mean
            spread = math.sqrt((xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
            half_det = 0.5 * (xx * (yy * zz - yz * yz) - xy * (xy * zz - xz * yz) + xz * (xy * yz - yy * xz))
            cube = spread**3
            cosine = min(max(half_det / cube, -1.0), 1.0) if cube > 0.0 else 0.0
            turn = math.acos(cosine) / 3.0
            first = mean + 2.0 * spread * math.cos(turn)
            last = mean + 2.0 * spread * math.cos(turn + 2.0 * math.pi / 3.0)
            middle = 3.0 * mean - first - last
            first, middle, last = max(first, 0.0), max(middle, 0.0), max(last, 0.0)
            length = 0.0
            if first > _LEAST_VARIANCE:
                length = math.sqrt(8.0 / math.pi * first) * _carlson_g(middle / first, last / first)
            found[k, b] = length + 3.0 * math.sqrt(max(first + middle + last - length * length, 0.0))
    return found


@jit("f8, f8")
def _carlson_g(m: float, c: float) -> float:
    """Return R_G(1, c, m) for 1 ≥ m ≥ c ≥ 0."""
    if m < _NEEDLE:
        return 0.5
    x, y, z = 1.0, c, m
    mean_f, mean_d = (1.0 + c + m) / 3.0, (1.0 + c + 3.0 * m) / 5.0
    x_f, y_f = mean_f - x, mean_f - y
    x_d, y_d = mean_d - x, mean_d - y
    # The values lie between c and 1: no distance from a mean is larger.
    left, power, series = _SERIES_RANGE * (1.0 - c), 1.0, 0.0
    while left * power > min(mean_f, mean_d):
        root_x, root_y, root_z = math.sqrt(x), math.sqrt(y), math.sqrt(z)
        shift = root_x * root_y + root_x * root_z + root_y * root_z
        series += power / (root_z * (z + shift))
        power *= 0.25
        x, y, z = 0.25 * (x + shift), 0.25 * (y + shift), 0.25 * (z + shift)
        mean_f, mean_d = 0.25 * (mean_f + shift), 0.25 * (mean_d + shift)
    X, Y = x_f * power / mean_f, y_f * power / mean_f
    Z = -(X + Y)
    E2, E3 = X * Y - Z * Z, X * Y * Z
    of_f = (1.0 - E2 / 10.0 + E3 / 14.0 + E2 * E2 / 24.0 - 3.0 * E2 * E3 / 44.0) / math.sqrt(mean_f)
    X, Y = x_d * power / mean_d, y_d * power / mean_d
    Z = -(X + Y) / 3.0
    E2, E3 = X * Y - 6.0 * Z * Z, (3.0 * X * Y - 8.0 * Z * Z) * Z
    E4, E5 = 3.0 * (X * Y - Z * Z) * Z * Z, X * Y * Z * Z * Z
    sums = 1.0 - 3.0 * E2 / 14.0 + E3 / 6.0 + 9.0 * E2 * E2 / 88.0
    sums += -3.0 * E4 / 22.0 - 9.0 * E2 * E3 / 52.0 + 3.0 * E5 / 26.0
    of_d = power * sums / (mean_d * math.sqrt(mean_d)) + 3.0 * series
    return 0.5 * (m * of_f + (1.0 - m) * (m - c) * of_d / 3.0 + math.sqrt(c / m))
