"""Normal equations of all views of a session at once, before Brown's camera."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.residuals.blocks import (
    BLOCK,
    POINT_RESIDUAL,
    POINT_ROWS,
    ROWS,
    add_products,
    evaluate,
    load,
)
from core.jit import jit


@jit(
    "i8[::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], b1[::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1], "
    "b1, f8, f8, f8[:, :, ::1], f8[:, ::1], f8[::1], f8[::1]",
    reassociates=True,
)
def normal_equations(
    first: Int[np.ndarray, " bounds"],
    points_target: Float[np.ndarray, "n 3"],
    centroids: Float[np.ndarray, "m 3"],
    points_px: Float[np.ndarray, "n 2"],
    weight: Float[np.ndarray, " n"],
    used: Bool[np.ndarray, " n"],
    parameters: Float[np.ndarray, "m 9"],
    rotations: Float[np.ndarray, "m 3 3"],
    translations_mm: Float[np.ndarray, "m 3"],
    robust: bool,
    cauchy: float,
    median_length: float,
    products: Float[np.ndarray, "m 15 15"],
    residuals: Float[np.ndarray, "2 n"],
    squared: Float[np.ndarray, " n"],
    cost: Float[np.ndarray, " m"],
) -> None:
    """Write for every view the products of derivatives and residuals, and residuals, squared distances and
    costs; `products` and `cost` come as zeros.

    Row and column 14 of the products belong to the residuals: [J r]ᵀ W [J r] with the camera's first eight parameters,
    a rotation about the centroid and a translation in J. Distances are in stated uncertainties, weight = 1/u². Plainly
    the points `used` count and a view's cost is the sum of their squares; where `robust`, all count with Cauchy's
    weights at the view's own scale s, the median distance over `median_length`, and the cost is 2 n log s.
    """
    points, rows = np.empty(POINT_ROWS * BLOCK), np.empty(ROWS * BLOCK)
    for i in range(len(parameters)):
        start, end = first[i], first[i + 1]
        count = end - start
        if count == 0:
            continue
        target, observed = points_target[start:end].T, points_px[start:end].T
        scale = 1.0
        root = np.where(used[start:end], np.sqrt(weight[start:end]), 0.0)
        if robust:  # weights come from the residuals
            for begin in range(0, count, BLOCK):
                full = load(target, centroids[i], observed, root, begin, points)
                evaluate(points, full, parameters[i], rotations[i], translations_mm[i], False, rows)
                _keep(points, start + begin, end, weight, residuals, squared)
            scale = max(np.sqrt(np.median(squared[start:end])) / median_length, 1e-9)
            beyond = squared[start:end] / (cauchy * scale) ** 2
            root = np.sqrt(weight[start:end] / (1.0 + beyond)) / scale
        for begin in range(0, count, BLOCK):
            full = load(target, centroids[i], observed, root, begin, points)
            evaluate(points, full, parameters[i], rotations[i], translations_mm[i], True, rows)
            if not robust:
                _keep(points, start + begin, end, weight, residuals, squared)
            add_products(rows, full, products[i])
        cost[i] = 2.0 * count * np.log(scale) if robust else products[i, 14, 14]
        for a in range(15):
            for b in range(a):
                products[i, b, a] = products[i, a, b]


@jit(inlined=True, reassociates=True)
def _keep(
    points: Float[np.ndarray, " coordinates"],
    begin: int,
    end: int,
    weight: Float[np.ndarray, " n"],
    residuals: Float[np.ndarray, "2 n"],
    squared: Float[np.ndarray, " n"],
) -> None:
    """Write a block's residuals and squared distances to those of all views, from `begin` on."""
    for k in range(min(BLOCK, end - begin)):
        u, v = points[BLOCK * POINT_RESIDUAL + k], points[BLOCK * (POINT_RESIDUAL + 1) + k]
        residuals[0, begin + k], residuals[1, begin + k] = u, v
        squared[begin + k] = (u * u + v * v) * weight[begin + k]
