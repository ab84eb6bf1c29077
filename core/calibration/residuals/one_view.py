"""One view before Brown's camera: residuals and derivatives, and the walk from a pose down to a minimum."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from core.calibration.residuals.blocks import (
    BLOCK,
    POINT_RESIDUAL,
    POINT_ROWS,
    POSE,
    RESIDUAL,
    ROWS,
    evaluate,
    load,
)
from core.jit import jit


@jit("f8[:, ::1], f8[:, ::1], f8[::1], f8[:, ::1], f8[::1], i8", reassociates=True)
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
    points, rows = np.empty(POINT_ROWS * BLOCK), np.empty(ROWS * BLOCK)
    one, nowhere = np.ones(count), np.zeros(3)
    for begin in range(0, count, BLOCK):
        full = load(target, nowhere, observed, one, begin, points)
        evaluate(points, full, parameters, rotation, translation_mm, True, rows)
        here = min(BLOCK, count - begin)
        for uv in range(2):
            start = BLOCK * (POINT_RESIDUAL + uv)
            residuals[uv, begin : begin + here] = points[start : start + here]
            for a in range(cameras + 6):
                start = BLOCK * (2 * (POSE - cameras + a) + uv)
                jacobian[a, uv, begin : begin + here] = rows[start : start + here]
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
    points, rows = np.empty(POINT_ROWS * BLOCK), np.empty(ROWS * BLOCK)
    products, H, L = np.empty((7, 7)), np.empty((7, 7)), np.empty((6, 6))
    unit, y, x, nowhere = np.empty(6), np.empty(6), np.empty(6), np.zeros(3)
    turn = np.empty((3, 3))
    best_R, best_t = rotation.copy(), translation_mm.copy()
    R, t = best_R.copy(), best_t.copy()
    cost, damping = np.inf, 0.0
    for _ in range(steps):
        before = True
        for i in range(target.shape[1]):
            depth = R[2, 0] * target[0, i] + R[2, 1] * target[1, i] + R[2, 2] * target[2, i] + t[2]
            before = before and depth > 0.0
        found = np.inf
        if before:
            products[:] = 0.0
            for begin in range(0, target.shape[1], BLOCK):
                full = load(target, nowhere, observed, root_weight, begin, points)
                evaluate(points, full, parameters, R, t, False, rows)
                _add_products_of_pose(rows, full, products)
            found = products[6, 6]
        if found < cost:
            gained = cost - found
            cost = found
            best_R[:], best_t[:] = R, t
            damping = 0.0 if damping < 1e-6 else 0.1 * damping
            if gained < max(least, share * (cost - known_cost)):
                break
            H[:] = products
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
            total = H[6, a] * unit[a]
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


@jit(inlined=True, reassociates=True)
def _add_products_of_pose(
    rows: Float[np.ndarray, " derivatives"], count: int, products: Float[np.ndarray, "7 7"]
) -> None:
    """Add to `products`, on and below its diagonal, those of a block's rows from the pose's on."""
    for a in range(RESIDUAL - POSE + 1):
        for b in range(a + 1):
            total = 0.0
            for uv in range(2):
                first, second = BLOCK * (2 * (POSE + a) + uv), BLOCK * (2 * (POSE + b) + uv)
                for k in range(count):
                    total += rows[first + k] * rows[second + k]
            products[a, b] += total
