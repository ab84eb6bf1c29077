"""Residuals of views and their derivatives by camera and pose, in one pass over the points.

The same numbers as `core.geometry.camera.project_with_jacobian` with the chain rule for the pose, without the arrays
in between: a fit of one image spends most of its time here.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from core.jit import jit
from core.numerics import block_products


@jit("f8[:, ::1], f8[:, ::1], f8[::1], f8[:, ::1], f8[::1], i8, f8[:, ::1], f8[:, :, ::1]")
def _evaluate(
    target: Float[np.ndarray, "3 n"],
    observed: Float[np.ndarray, "2 n"],
    parameters: Float[np.ndarray, "9"],
    rotation: Float[np.ndarray, "3 3"],
    translation_mm: Float[np.ndarray, "3"],
    cameras: int,
    residuals: Float[np.ndarray, "2 n"],
    jacobian: Float[np.ndarray, "p 2 n"],
) -> None:
    """Write residuals and derivatives to arrays given; see `residuals_with_jacobian`."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = parameters
    count = target.shape[1]
    for i in range(count):
        a, b, c = target[0, i], target[1, i], target[2, i]
        X = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
        Y = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
        Z = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
        depth_inverse = 1.0 / (Z + translation_mm[2])
        x = (X + translation_mm[0]) * depth_inverse
        y = (Y + translation_mm[1]) * depth_inverse
        r2 = x * x + y * y
        xy2, ax, ay = 2.0 * x * y, r2 + 2.0 * x * x, r2 + 2.0 * y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * k1 + r2 * (4.0 * k2 + r2 * 6.0 * k3)  # dg/dx = slope·x
        distorted_x = x * radial + p1 * xy2 + p2 * ax
        distorted_y = y * radial + p1 * ay + p2 * xy2
        residuals[0, i] = observed[0, i] - (fx * distorted_x + cx)
        residuals[1, i] = observed[1, i] - (fy * distorted_y + cy)
        if cameras:
            jacobian[0, 0, i], jacobian[0, 1, i] = distorted_x, 0.0
            jacobian[1, 0, i], jacobian[1, 1, i] = 0.0, distorted_y
            jacobian[2, 0, i], jacobian[2, 1, i] = 1.0, 0.0
            jacobian[3, 0, i], jacobian[3, 1, i] = 0.0, 1.0
            jacobian[4, 0, i], jacobian[4, 1, i] = fx * x * r2, fy * y * r2
            jacobian[5, 0, i], jacobian[5, 1, i] = fx * x * r2 * r2, fy * y * r2 * r2
            jacobian[6, 0, i], jacobian[6, 1, i] = fx * xy2, fy * ay
            jacobian[7, 0, i], jacobian[7, 1, i] = fx * ax, fy * xy2
        dxx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        dyy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        dxy = 0.5 * slope * xy2 + 2.0 * p1 * x + 2.0 * p2 * y
        for row, scale, by_x, by_y in ((0, fx, dxx, dxy), (1, fy, dxy, dyy)):
            by_X, by_Y = scale * depth_inverse * by_x, scale * depth_inverse * by_y
            by_Z = -(by_X * x + by_Y * y)
            jacobian[cameras, row, i] = by_Z * Y - by_Y * Z  # d(exp(w) R x)/dw = w × (R x)
            jacobian[cameras + 1, row, i] = by_X * Z - by_Z * X
            jacobian[cameras + 2, row, i] = by_Y * X - by_X * Y
            jacobian[cameras + 3, row, i] = by_X
            jacobian[cameras + 4, row, i] = by_Y
            jacobian[cameras + 5, row, i] = by_Z


@jit("f8[:, ::1], f8[:, ::1], f8[::1], f8[:, ::1], f8[::1], i8")
def residuals_with_jacobian(
    target: Float[np.ndarray, "3 n"],
    observed: Float[np.ndarray, "2 n"],
    parameters: Float[np.ndarray, "9"],
    rotation: Float[np.ndarray, "3 3"],
    translation_mm: Float[np.ndarray, "3"],
    cameras: int,
) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "p 2 n"]]:
    """Return observed - predicted (px) and the derivatives of the prediction.

    `target` are points about their centroid (mm), `translation_mm` the centroid in the camera frame, `parameters` in
    the order of `CAMERA_PARAMETERS`. Derivatives are by the first `cameras` of these (8 or 0), then by a rotation from
    the left about the centroid and by the translation.
    """
    count = target.shape[1]
    residuals = np.empty((2, count))
    jacobian = np.empty((cameras + 6, 2, count))
    _evaluate(target, observed, parameters, rotation, translation_mm, cameras, residuals, jacobian)
    return residuals, jacobian


@jit("f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8[:, ::1], f8[::1], i8, f8, f8, f8", reassociates=True)
def descend(
    target: Float[np.ndarray, "3 n"],
    observed: Float[np.ndarray, "2 n"],
    root_weight: Float[np.ndarray, " n"],
    parameters: Float[np.ndarray, "9"],
    rotation: Float[np.ndarray, "3 3"],
    translation_mm: Float[np.ndarray, "3"],
    steps: int,
    known_cost: float,
    share: float,
    least: float,
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"], float]:
    """Walk from a pose down to the minimum of Σ w² |residual|² in whose valley it lies, the camera held: by Levenberg's
    and Marquardt's method, `steps` evaluations at most.

    Returns rotation, translation and the cost. Steps end where they gain less than `least`, or than `share` of what the
    cost is above `known_cost`. A trial behind the camera is no step.
    """
    count = target.shape[1]
    residuals, jacobian = np.empty((2, count)), np.empty((6, 2, count))
    H, L = np.empty((6, 6)), np.empty((6, 6))
    g, unit, y, x = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    turn = np.empty((3, 3))
    best_R, best_t = rotation.copy(), translation_mm.copy()
    R, t = best_R.copy(), best_t.copy()
    cost, damping = np.inf, 0.0
    for _ in range(steps):
        before = True
        for i in range(count):
            depth = R[2, 0] * target[0, i] + R[2, 1] * target[1, i] + R[2, 2] * target[2, i] + t[2]
            before = before and depth > 0.0
        found = np.inf
        if before:
            _evaluate(target, observed, parameters, R, t, 0, residuals, jacobian)
            found = 0.0
            for i in range(count):
                w = root_weight[i]
                for row in range(2):
                    residuals[row, i] *= w
                    found += residuals[row, i] * residuals[row, i]
        if found < cost:
            gained = cost - found
            cost = found
            best_R[:], best_t[:] = R, t
            damping = 0.0 if damping < 1e-6 else 0.1 * damping
            if gained < max(least, share * (cost - known_cost)):
                break
            for a in range(6):
                for i in range(count):
                    jacobian[a, 0, i] *= root_weight[i]
                    jacobian[a, 1, i] *= root_weight[i]
            for a in range(6):
                for b in range(a + 1):
                    total = 0.0
                    for row in range(2):
                        for i in range(count):
                            total += jacobian[a, row, i] * jacobian[b, row, i]
                    H[a, b] = H[b, a] = total
                total = 0.0
                for row in range(2):
                    for i in range(count):
                        total += jacobian[a, row, i] * residuals[row, i]
                g[a] = total
        else:
            damping = max(10.0 * damping, 1e-4)
        if not cost < np.inf:
            break
        sound = True
        for a in range(6):
            sound = sound and H[a, a] > 0.0
            unit[a] = 1.0 / np.sqrt(H[a, a]) if H[a, a] > 0.0 else 0.0
        for a in range(6):
            for b in range(a + 1):
                total = H[a, b] * unit[a] * unit[b]
                for k in range(b):
                    total -= L[a, k] * L[b, k]
                if a > b:
                    L[a, b] = total / L[b, b]
                else:
                    total += damping
                    sound = sound and total > 0.0
                    L[a, a] = np.sqrt(total) if total > 0.0 else 1.0
        if not sound:
            damping = max(10.0 * damping, 1e-4)
            continue
        gain = 0.0
        for a in range(6):
            total = g[a] * unit[a]
            for k in range(a):
                total -= L[a, k] * y[k]
            y[a] = total / L[a, a]
            gain += y[a] * y[a]
        if gain < max(least, share * (cost - known_cost)):
            break
        for a in range(5, -1, -1):
            total = y[a]
            for k in range(a + 1, 6):
                total -= L[k, a] * x[k]
            x[a] = total / L[a, a]
        for a in range(6):
            x[a] *= unit[a]
        _rotate(x, turn)
        R = turn @ best_R
        t = best_t + x[3:]
    return best_R, best_t, cost


@jit("f8[::1], f8[:, ::1]")
def _rotate(w: Float[np.ndarray, " p"], turn: Float[np.ndarray, "3 3"]) -> None:
    """Write exp([w]×) of the first three of `w`, by Rodrigues' formula."""
    x, y, z = w[0], w[1], w[2]
    square = x * x + y * y + z * z
    a, b = 1.0 - square / 6.0, 0.5 - square / 24.0
    if square > 1e-8:
        angle = np.sqrt(square)
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
    turn[0, 0], turn[0, 1], turn[0, 2] = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    turn[1, 0], turn[1, 1], turn[1, 2] = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
    turn[2, 0], turn[2, 1], turn[2, 2] = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)


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
    for i in range(len(parameters)):
        start, end = first[i], first[i + 1]
        count = end - start
        if count == 0:
            continue
        target, observed, rows = np.empty((3, count)), np.empty((2, count)), np.empty((15, 2, count))
        for k in range(count):
            for j in range(3):
                target[j, k] = points_target[start + k, j] - centroids[i, j]
            for j in range(2):
                observed[j, k] = points_px[start + k, j]
        _evaluate(
            target,
            observed,
            parameters[i],
            rotations[i],
            translations_mm[i],
            8,
            rows[14],
            rows[:14],
        )
        for k in range(count):
            u, v = rows[14, 0, k], rows[14, 1, k]
            residuals[0, start + k], residuals[1, start + k] = u, v
            squared[start + k] = (u * u + v * v) * weight[start + k]
        root = np.empty(count)
        if robust:
            scale = max(np.sqrt(np.median(squared[start:end])) / median_length, 1e-9)
            cost[i] = 2.0 * count * np.log(scale)
            for k in range(count):
                beyond = squared[start + k] / (cauchy * scale) ** 2
                root[k] = np.sqrt(weight[start + k] / (1.0 + beyond)) / scale
        else:
            for k in range(count):
                if used[start + k]:
                    cost[i] += squared[start + k]
                    root[k] = np.sqrt(weight[start + k])
                else:
                    root[k] = 0.0
        for a in range(15):
            for k in range(count):
                rows[a, 0, k] *= root[k]
                rows[a, 1, k] *= root[k]
        block_products(rows.reshape(15, 2 * count), products[i])
