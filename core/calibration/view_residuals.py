"""Residuals of one view and their derivatives by camera and pose, in one pass over the points.

The same numbers as `core.camera.project_with_jacobian` with the chain rule for the pose, without the arrays in between:
a fit of one image spends most of its time here.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from core.compiled import compiled


@compiled
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
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = parameters
    count = target.shape[1]
    residuals = np.empty((2, count))
    jacobian = np.empty((cameras + 6, 2, count))
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
    return residuals, jacobian
