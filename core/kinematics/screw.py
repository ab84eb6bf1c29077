"""Closed forms of one joint's motion, where its fits start.

The direction is what the rotations share: rotation vectors about their mean all lie along the axis, so it is their
first principal direction, by the encoder's sense. The axis then follows from positions, which are linear in c and u of
p_k = c + D_k u once D_k is known (Chasles: any motion is a screw; a joint's has no pitch). Positions alone, with the
encoder's angles, are linear in a + b cos θ + e sin θ, whose axis is along b × e through a.

References: M. Chasles, Bulletin des Sciences Mathématiques 14 (1830) 321-326; J. M. Hollerbach, C. W. Wampler, "The
calibration index and taxonomy for robot kinematic calibration methods", Int. J. Robotics Research 15 (1996) 573-591
(screw-axis measurement).
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from core.errors import DegenerateGeometry
from core.kinematics.arc import Motion, rotations_about
from core.kinematics.circle import fit_circle
from core.transforms import nearest_rotation

_LOGARITHMS = math.radians(300.0)  # of arc: beyond, rotation vectors about the mean wrap


def motion_by_rotations(
    positions: Float[np.ndarray, "n 3"],
    rotations: Float[np.ndarray, "n 3 3"],
    encoder: Float[np.ndarray, " n"],
    *,
    free_angles: bool,
) -> Motion:
    """Return the motion of poses; `encoder` is in rad about its mean."""
    total = rotations.sum(axis=0)
    mean = nearest_rotation(total)
    if float(np.ptp(encoder)) < _LOGARITHMS:
        turns = Rotation.from_matrix(rotations @ mean.T).as_rotvec()
        turns = turns - turns.mean(axis=0)
        n = np.linalg.svd(turns, full_matrices=False)[2][0]
        n = n if float(turns @ n @ encoder) >= 0.0 else -n
    else:  # Σ R_k keeps along the axis what it loses across
        n = np.linalg.svd(total)[0][:, 0]
        n = n if _disagreement(n, rotations, encoder) <= _disagreement(-n, rotations, encoder) else -n
    angles = encoder
    if free_angles:
        angles = encoder + _along(n, rotations, encoder)
    D = rotations_about(n, angles)
    A = np.concatenate([np.broadcast_to(np.eye(3), D.shape), D], axis=2).reshape(-1, 6)
    found = np.linalg.lstsq(A, positions.ravel(), rcond=1e-9)[0]
    R_0 = nearest_rotation((D.swapaxes(1, 2) @ rotations).sum(axis=0))
    return _placed(found[:3], n, found[:3] + found[3:], R_0, angles)


def motion_by_encoder(positions: Float[np.ndarray, "n 3"], encoder: Float[np.ndarray, " n"]) -> Motion:
    """Return the motion of positions at the encoder's angles.

    Raises DegenerateGeometry where the positions do not go round.
    """
    A = np.column_stack([np.ones(len(encoder)), np.cos(encoder), np.sin(encoder)])
    a, b, e = np.linalg.lstsq(A, positions, rcond=None)[0]
    n = np.cross(b, e)
    length = float(np.linalg.norm(n))
    if not length > 1e-12 * max(float(b @ b), float(e @ e), 1e-12):
        raise DegenerateGeometry(
            "The positions of a sweep do not go round an axis.",
            "Mount the camera or reflector away from the joint's axis, and check that the joint turns.",
        )
    return _placed(a, n / length, a + b, None, encoder)


def motion_by_circle(positions: Float[np.ndarray, "n 3"], encoder: Float[np.ndarray, " n"]) -> Motion:
    """Return the motion of positions by the circle through them; the encoder tells its sense and the turns.

    Raises DegenerateGeometry where no circle can be fitted.
    """
    circle = fit_circle(positions)
    middle = positions[int(np.argmin(np.abs(encoder)))] - circle.centre
    e1 = middle - circle.normal * (circle.normal @ middle)
    e1 /= max(float(np.linalg.norm(e1)), 1e-300)
    best: tuple[float, Motion] | None = None
    for n in (circle.normal, -circle.normal):
        out = positions - circle.centre
        angles = np.arctan2(out @ np.cross(n, e1), out @ e1)
        off = _wrapped(angles - encoder)
        shift = math.atan2(float(np.sin(off).mean()), float(np.cos(off).mean()))
        off = _wrapped(off - shift)
        motion = _placed(circle.centre, n, circle.centre + circle.radius * e1, None, encoder + shift + off)
        if best is None or float(off @ off) < best[0]:
            best = float(off @ off), motion
    assert best is not None
    return best[1]


def _along(
    n: Float[np.ndarray, "3"], rotations: Float[np.ndarray, "n 3 3"], encoder: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return how much further than the encoder says each pose turned about n, against the mean of all."""
    left = rotations_about(n, -encoder) @ rotations
    return np.asarray(Rotation.from_matrix(left @ nearest_rotation(left.sum(axis=0)).T).as_rotvec() @ n)


def _disagreement(
    n: Float[np.ndarray, "3"], rotations: Float[np.ndarray, "n 3 3"], encoder: Float[np.ndarray, " n"]
) -> float:
    left = rotations_about(n, -encoder) @ rotations
    return -float(np.linalg.norm(left.sum(axis=0)))


def _placed(
    point: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
    position: Float[np.ndarray, "3"],
    rotation: Float[np.ndarray, "3 3"] | None,
    angles: Float[np.ndarray, " n"],
) -> Motion:
    """Return the motion with its point at the foot of the pose at φ = 0."""
    foot = point + direction * (direction @ (position - point))
    return Motion(foot, direction, position, rotation, np.asarray(angles))


def _wrapped(angles: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return np.asarray((angles + math.pi) % (2.0 * math.pi) - math.pi)
