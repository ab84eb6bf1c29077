"""What an oracle with the same priors would state of distances: the whole problem at once, its noise known.

Camera, poses and every departure of the print are solved for in one dense system of normal equations. By the Bayesian
Cramér-Rao bound nobody who has no other priors can state less.

References: H. L. Van Trees, "Detection, Estimation and Modulation Theory", part I, 1968, §2.4.3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from core.calibration import ShapePrior, camera_prior
from core.calibration.target_shape.departures import Departures
from core.geometry import Camera, project_with_jacobian
from core.session import MeasuredPose
from core.targets import TargetSpec

CAMERA = 8


@dataclass(frozen=True)
class Oracle:
    """Covariance of the positions of poses (mm²) by name, u of the print's scale, and of the aspect over its prior."""

    names: tuple[str, ...]
    positions_mm: np.ndarray
    covariance: np.ndarray
    scale: float
    aspect: float

    @classmethod
    def of(
        cls, target: TargetSpec, camera: Camera, at: Mapping[str, MeasuredPose], noise_px: float
    ) -> Oracle:
        """Return what views of these poses say, each point of each with this noise."""
        departures = Departures.of(target, ShapePrior.of(target))
        points, names = target.points_target(), tuple(sorted(at))
        n, low = len(points), len(departures.names)
        size = CAMERA + low + 2 * n
        N = np.zeros((size + 6 * len(names),) * 2)
        N[CAMERA:size, CAMERA:size] = np.eye(low + 2 * n)
        width, height = round(2.0 * camera.cx_px), round(2.0 * camera.cy_px)
        _, Q = camera_prior(width, height, None)(camera.as_array()[:CAMERA])
        N[:CAMERA, :CAMERA] += Q.T @ Q
        for k, name in enumerate(names):
            R, p = at[name].rotation, at[name].position_mm
            assert R is not None
            _, by_camera, by_point = project_with_jacobian((points - p) @ R, camera)
            by_place = np.einsum("kcn,jk->jcn", by_point, R)
            J = np.zeros((len(N), 2, n))
            J[:CAMERA] = by_camera[:CAMERA]
            J[CAMERA : CAMERA + low] = np.einsum("jcn,kjn->kcn", by_place, departures.fields)
            for j in range(2):
                rows = CAMERA + low + 2 * np.arange(n) + j
                J[rows, :, np.arange(n)] = departures.point_mm * by_place[j].T
            first = size + 6 * k
            J[first : first + 3] = -by_place
            turned = np.cross(np.eye(3)[:, None, :], (points - p)[None])
            J[first + 3 : first + 6] = np.einsum("jcn,inj->icn", by_place, turned)
            flat = J.reshape(len(N), -1)
            N += flat @ flat.T / noise_px**2
        unit = 1.0 / np.sqrt(np.diag(N))
        C = np.linalg.inv(N * np.outer(unit, unit)) * np.outer(unit, unit)
        aspect = math.sqrt(C[CAMERA, CAMERA])
        places = (size + 6 * np.arange(len(names))[:, None] + np.arange(3)).ravel()
        return cls(
            names,
            np.array([at[name].position_mm for name in names]),
            C[np.ix_(places, places)],
            departures.scale_left(0.0, departures.aspect * aspect),
            aspect,
        )

    def of_distance(self, one: str, other: str) -> float:
        """Return the standard uncertainty of the distance of two poses, mm."""
        i, j = self.names.index(one), self.names.index(other)
        way = self.positions_mm[i] - self.positions_mm[j]
        length = float(np.linalg.norm(way))
        gradient = np.zeros(len(self.covariance))
        gradient[3 * i : 3 * i + 3], gradient[3 * j : 3 * j + 3] = way / length, -way / length
        return math.hypot(math.sqrt(gradient @ self.covariance @ gradient), self.scale * length)
