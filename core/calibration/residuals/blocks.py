"""Points in blocks, with their residuals and derivatives: what the compiled kernels of Brown's camera are made of.

The same numbers as `core.geometry.camera.project_with_jacobian` with the chain rule for the pose, in one pass. The rows
of a block lie in one array, at distances that are constants. Among thirty rows whose distances only the caller knows,
the compiler would have to check that none overlaps another; it leaves such loops without vectors.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from core.jit import jit

BLOCK = 192
"""Points. Rows at a distance of a power of two would share the same lines of the processor's cache."""
_LANES = 8
"""Points in the widest vector: a block that ends within one would go on point by point."""
POINT_ROWS, POINT_RESIDUAL, ROWS = 8, 6, 30
_POINT = tuple(np.uint64(BLOCK * row) for row in range(POINT_ROWS))
"""Where rows of points begin. Indices without a sign spare the question whether they count from the end."""
_U = tuple(np.uint64(BLOCK * row) for row in range(0, ROWS, 2))
_V = tuple(np.uint64(BLOCK * row) for row in range(1, ROWS, 2))
"""Where rows of derivatives begin, of u and of v."""
POSE, RESIDUAL = 8, 14
"""The first pair of rows by the pose, and the pair of the residual."""


@jit(inlined=True, reassociates=True)
def load(
    target: Float[np.ndarray, "3 n"],
    centroid: Float[np.ndarray, "3"],
    observed: Float[np.ndarray, "2 n"],
    root_weight: Float[np.ndarray, " n"],
    begin: int,
    points: Float[np.ndarray, " coordinates"],
) -> int:
    """Write to `points` a block of those from `begin` on; return how many it has, those of full vectors included.

    Rows are: a point about the centroid (3), where it was seen (2), the root of its weight; the residual (2), not
    weighted, comes to the last two. The last point is repeated, without weight, until vectors are full.
    """
    count = min(BLOCK, target.shape[1] - begin)
    full = (count + _LANES - 1) // _LANES * _LANES
    for k in range(full):
        taken = begin + min(k, count - 1)
        for row in range(3):
            points[BLOCK * row + k] = target[row, taken] - centroid[row]
        points[BLOCK * 3 + k], points[BLOCK * 4 + k] = observed[0, taken], observed[1, taken]
        points[BLOCK * 5 + k] = root_weight[taken] if k < count else 0.0
    return full


@jit(inlined=True, reassociates=True)
def evaluate(
    points: Float[np.ndarray, " coordinates"],
    count: int,
    parameters: Float[np.ndarray, "9"],
    rotation: Float[np.ndarray, "3 3"],
    translation_mm: Float[np.ndarray, "3"],
    by_camera: bool,
    rows: Float[np.ndarray, " derivatives"],
) -> None:
    """Write to `rows` a block's derivatives and residuals, weighted, in pairs of u and v: by eight camera parameters
    (where `by_camera`), a rotation from the left about the centroid and a translation; the residual.
    """
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = parameters
    r00, r01, r02 = rotation[0]
    r10, r11, r12 = rotation[1]
    r20, r21, r22 = rotation[2]
    tx, ty, tz = translation_mm
    for k in range(count):
        i = np.uint64(k)
        a, b, c = points[i + _POINT[0]], points[i + _POINT[1]], points[i + _POINT[2]]
        X = r00 * a + r01 * b + r02 * c
        Y = r10 * a + r11 * b + r12 * c
        Z = r20 * a + r21 * b + r22 * c
        depth_inverse = 1.0 / (Z + tz)
        x = (X + tx) * depth_inverse
        y = (Y + ty) * depth_inverse
        r2 = x * x + y * y
        xy2, ax, ay = 2.0 * x * y, r2 + 2.0 * x * x, r2 + 2.0 * y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * k1 + r2 * (4.0 * k2 + r2 * 6.0 * k3)  # dg/dx = slope·x
        distorted_x = x * radial + p1 * xy2 + p2 * ax
        distorted_y = y * radial + p1 * ay + p2 * xy2
        w = points[i + _POINT[5]]
        u = points[i + _POINT[3]] - (fx * distorted_x + cx)
        v = points[i + _POINT[4]] - (fy * distorted_y + cy)
        points[i + _POINT[6]], points[i + _POINT[7]] = u, v
        rows[i + _U[14]], rows[i + _V[14]] = w * u, w * v
        w_fx, w_fy = w * fx, w * fy
        if by_camera:
            rows[i + _U[0]], rows[i + _V[0]] = w * distorted_x, 0.0
            rows[i + _U[1]], rows[i + _V[1]] = 0.0, w * distorted_y
            rows[i + _U[2]], rows[i + _V[2]] = w, 0.0
            rows[i + _U[3]], rows[i + _V[3]] = 0.0, w
            rows[i + _U[4]], rows[i + _V[4]] = w_fx * x * r2, w_fy * y * r2
            rows[i + _U[5]], rows[i + _V[5]] = w_fx * x * r2 * r2, w_fy * y * r2 * r2
            rows[i + _U[6]], rows[i + _V[6]] = w_fx * xy2, w_fy * ay
            rows[i + _U[7]], rows[i + _V[7]] = w_fx * ax, w_fy * xy2
        dxx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        dyy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        dxy = 0.5 * slope * xy2 + 2.0 * p1 * x + 2.0 * p2 * y
        u_X, u_Y = w_fx * depth_inverse * dxx, w_fx * depth_inverse * dxy
        v_X, v_Y = w_fy * depth_inverse * dxy, w_fy * depth_inverse * dyy
        u_Z, v_Z = -(u_X * x + u_Y * y), -(v_X * x + v_Y * y)
        # d(exp(w) R x)/dw = w × (R x)
        rows[i + _U[8]], rows[i + _V[8]] = u_Z * Y - u_Y * Z, v_Z * Y - v_Y * Z
        rows[i + _U[9]], rows[i + _V[9]] = u_X * Z - u_Z * X, v_X * Z - v_Z * X
        rows[i + _U[10]], rows[i + _V[10]] = u_Y * X - u_X * Y, v_Y * X - v_X * Y
        rows[i + _U[11]], rows[i + _V[11]] = u_X, v_X
        rows[i + _U[12]], rows[i + _V[12]] = u_Y, v_Y
        rows[i + _U[13]], rows[i + _V[13]] = u_Z, v_Z


@jit(inlined=True, reassociates=True)
def add_products(
    rows: Float[np.ndarray, " derivatives"], count: int, products: Float[np.ndarray, "15 15"]
) -> None:
    """Add to `products`, on and below its diagonal, those of a block's rows: 3 x 3 at a time, which stay in
    registers.
    """
    for i in range(0, 15, 3):
        for j in range(0, i + 1, 3):
            ax = ay = az = bx = by = bz = cx = cy = cz = 0.0
            for uv in range(2):
                first, second = np.uint64(BLOCK * (2 * i + uv)), np.uint64(BLOCK * (2 * j + uv))
                for at in range(count):
                    k = np.uint64(at)
                    a, b, c = rows[first + k], rows[first + k + _U[1]], rows[first + k + _U[2]]
                    x, y, z = rows[second + k], rows[second + k + _U[1]], rows[second + k + _U[2]]
                    ax += a * x
                    ay += a * y
                    az += a * z
                    bx += b * x
                    by += b * y
                    bz += b * z
                    cx += c * x
                    cy += c * y
                    cz += c * z
            products[i, j] += ax
            products[i, j + 1] += ay
            products[i, j + 2] += az
            products[i + 1, j] += bx
            products[i + 1, j + 1] += by
            products[i + 1, j + 2] += bz
            products[i + 2, j] += cx
            products[i + 2, j + 1] += cy
            products[i + 2, j + 2] += cz
