"""One focal length and the pose, refined on some points of one view: what baselines of few parameters share."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from core.calibration import PLAUSIBLE_START, SMALLEST_NOISE_PX
from core.errors import ADVISED_TILT, DegenerateGeometry, NotConverged
from core.geometry import Camera, project_with_jacobian, so3_exp, transform
from core.numerics import fit
from core.targets import GridPoints


def refine_single_focal(
    points: GridPoints,
    chosen: Int[np.ndarray, " n"],
    camera: Camera,
    T_camera_target: Float[np.ndarray, "4 4"],
) -> tuple[Camera, Float[np.ndarray, "4 4"]]:
    """Return f = fx = fy and the pose of least residuals at the chosen points, from those given; all else of the
    camera stays.

    Raises NotConverged.
    """
    middle = points.points_target[chosen].mean(axis=0)
    target, pixels = points.points_target[chosen] - middle, points.points_px[chosen]
    R, t = T_camera_target[:3, :3], T_camera_target[:3, 3]
    # State: log f, rotation about the points' middle, and that middle.
    state = np.concatenate([[np.log(camera.fx_px)], R.ravel(), R @ middle + t])

    def evaluate(
        state: Float[np.ndarray, "13"],
    ) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "7 2 n"]]:
        f, rotation = float(np.exp(state[0])), state[1:10].reshape(3, 3)
        turned = target @ rotation.T
        inside = turned + state[10:]
        predicted, by_camera, by_point = project_with_jacobian(inside, _with(camera, f))
        by_turn = np.stack([np.einsum("kcn,nk->cn", by_point, np.cross(axis, turned)) for axis in np.eye(3)])
        jacobian = np.concatenate([f * (by_camera[0] + by_camera[1])[None], by_turn, by_point])
        return pixels.T - predicted, jacobian

    def retract(state: Float[np.ndarray, "13"], step: Float[np.ndarray, "7"]) -> Float[np.ndarray, "13"]:
        rotation = so3_exp(step[1:4]) @ state[1:10].reshape(3, 3)
        return np.concatenate(
            [[state[0] + np.clip(step[0], -0.7, 0.7)], rotation.ravel(), state[10:] + step[4:]]
        )

    noise = points.standard_uncertainty_px[chosen]
    result = fit(evaluate, retract, state, noise, smallest_scale=SMALLEST_NOISE_PX)
    found = result.state
    rotation = found[1:10].reshape(3, 3)
    T = transform(rotation, found[10:] - rotation @ middle)
    if not result.converged or np.any(points.points_target @ T[2, :3] + T[2, 3] <= 0.0):
        raise NotConverged("Focal length and pose did not converge to a view of the grid from its front.")
    return _with(camera, float(np.exp(found[0]))), T


def require_plausible(f_px: float, points: GridPoints) -> None:
    """Raise DegenerateGeometry for a focal length that no camera has: the view does not determine it."""
    least, most = PLAUSIBLE_START
    if not least < f_px / points.image_width_px < most:
        raise DegenerateGeometry(
            f"The focal length comes out as {f_px / points.image_width_px:.3g} image widths: the grid is parallel "
            "to the image, or so nearly that noise exceeds the foreshortening.",
            f"Tilt the grid by {ADVISED_TILT}.",
        )


def _with(camera: Camera, f: float) -> Camera:
    return Camera(f, f, camera.cx_px, camera.cy_px, camera.k1)
