"""The type of each link, decided on predicted uncertainties: common normal, Hayati's form, or coincident axes."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.kinematics.circle_point_analysis.common_normals import Axes, LinkForm, choose_signs, feet
from core.kinematics.circle_point_analysis.covariance import UncertainAxes
from core.kinematics.circle_point_analysis.target_registration import STEP_RAD
from core.kinematics.dh import Chain, nearly_parallel

_LARGEST_TURN = 0.1
"""rad: where x' between parallel axes is more uncertain than this, they are taken for one line."""


def classify_links(
    uncertain: UncertainAxes, home: Float[np.ndarray, " j"], nominal: Chain | None
) -> tuple[LinkForm, ...]:
    """Return the form of each link but the last, at joint angles `home` (rad); Hayati's where the nominal states β."""
    axes = uncertain.axes
    count = len(axes) - 1
    if not count:
        return ()
    alphas = [_angle(axes, i) for i in range(count)]
    sigma_d = np.full(count, np.inf)
    inclined = [i for i in range(count) if feet(axes, i)[2] > 10.0 * STEP_RAD]
    if inclined:
        slides = uncertain.propagate_covariance(lambda at: np.array([feet(at, i)[0] for i in inclined]))
        sigma_d[inclined] = np.sqrt(np.diag(slides))
    stated = [nominal is not None and nominal.joints[i].beta_rad != 0.0 for i in range(count)]
    parallel = [
        nearly_parallel(alphas[i], math.inf if stated[i] else float(sigma_d[i])) for i in range(count)
    ]
    offsets = uncertain.propagate_covariance(
        lambda at: np.concatenate([_offset(at, axes, i) for i in range(count)])
    )
    sigma_a = np.sqrt(np.diag(offsets)).reshape(count, 3).max(axis=1)
    length = [float(np.linalg.norm(_offset(axes, axes, i))) for i in range(count)]
    coincident = [
        bool(p and s > _LARGEST_TURN * max(a, 1e-12))
        for p, s, a in zip(parallel, sigma_a, length, strict=True)
    ]
    return choose_signs(axes, home, parallel, coincident, nominal, sigma_a)


def _angle(axes: Axes, link: int) -> float:
    n, m = axes.directions[link], axes.directions[link + 1]
    return math.atan2(float(np.linalg.norm(np.cross(n, m))), float(n @ m))


def _offset(axes: Axes, at: Axes, link: int) -> Float[np.ndarray, "3"]:
    """Return how far apart neighbouring axes are, where the first of them was fitted; a vector across the first."""
    n, m = axes.directions[link], axes.directions[link + 1]
    across = np.cross(at.directions[link], at.directions[link + 1])
    out = axes.points[link + 1] - axes.points[link]
    sine = float(np.linalg.norm(across))
    if sine > 0.1:
        return np.asarray(across / sine * (out @ across) / sine)
    out = out - m * (out @ n) / (m @ n)
    return np.asarray(out)
