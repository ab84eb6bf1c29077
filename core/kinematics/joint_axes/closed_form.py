"""Closed forms of one joint's motion, the start of its fits: by rotations, by the encoder, by a circle.

All are computed for several sets of poses at once.

Motion: the direction is what the rotations share: rotation vectors about their mean all lie along the axis, so it is
their first principal direction, by the encoder's sense. The axis then follows from positions, which are linear in c and
u of p_k = c + D_k u once D_k is known (Chasles: any motion is a screw; a joint's has no pitch). Positions alone, with
the encoder's angles, are linear in a + b cos θ + e sin θ, whose axis is along b × e through a.

Circle through points in space, from positions alone: the plane is that of the two largest singular values of the points
about their mean. In it the algebraic circle A (x² + y²) + B x + C y + D = 0 is fitted under Taubin's constraint, which
makes the radius nearly unbiased: with Z the centred squares z = x² + y² divided by 2 sqrt(mean z), the singular vector
of [Z x y] of the least singular value.

References: M. Chasles, Bulletin des Sciences Mathématiques 14 (1830) 321-326; J. M. Hollerbach, C. W. Wampler, "The
calibration index and taxonomy for robot kinematic calibration methods", Int. J. Robotics Research 15 (1996) 573-591
(screw-axis measurement); G. Taubin, IEEE PAMI 13 (1991) 1115-1138, 10.1109/34.103273; N. Chernov, "Circular and Linear
Regression", 2010, section 5.9 (by SVD).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.errors import DegenerateGeometry
from core.geometry import nearest_rotation, rotation_vectors, rotations_about
from core.kinematics.joint_axes.arc_model import Motion

_LOGARITHMS = math.radians(300.0)  # of arc: beyond, rotation vectors about the mean wrap
_ROUND = 1e-12  # of the positions' extent squared


@dataclass(frozen=True, slots=True)
class Motions:
    """A motion for each set of poses, in the leading axis of `all`; what stands where there is `none` means nothing."""

    all: Motion
    none: Bool[np.ndarray, " b"]


def motions_by_rotations(
    positions: Float[np.ndarray, "b n 3"],
    rotations: Float[np.ndarray, "b n 3 3"],
    encoder: Float[np.ndarray, "b n"],
    *,
    free_angles: bool,
) -> Motions:
    """Return the motions of poses; `encoder` is in rad about a middle."""
    total = rotations.sum(axis=1)
    if float(np.ptp(encoder, axis=1).max()) < _LOGARITHMS:
        turns = _logarithms(rotations @ nearest_rotation(total)[:, None].swapaxes(2, 3))
        turns = turns - turns.mean(axis=1, keepdims=True)
        n = np.linalg.svd(turns, full_matrices=False)[2][:, 0]
        sense = np.einsum("bnk,bk,bn->b", turns, n, encoder)
        n = np.where(sense >= 0.0, 1.0, -1.0)[:, None] * n
    else:  # Σ R_k keeps along the axis what it loses across
        n = np.linalg.svd(total)[0][:, :, 0]
        kept, other = (_agreement(sign * n, rotations, encoder) for sign in (1.0, -1.0))
        n = np.where(kept >= other, 1.0, -1.0)[:, None] * n
    angles = encoder
    if free_angles:
        angles = encoder + _along(n, rotations, encoder)
    D = rotations_about(n, angles)
    A = np.concatenate([np.broadcast_to(np.eye(3), D.shape), D], axis=3).reshape(len(D), -1, 6)
    found = (np.linalg.pinv(A, rcond=1e-9) @ positions.reshape(len(D), -1, 1))[:, :, 0]
    R_0 = nearest_rotation((D.swapaxes(2, 3) @ rotations).sum(axis=1))
    placed = _placed(found[:, :3], n, found[:, :3] + found[:, 3:], R_0, angles)
    return Motions(placed, np.zeros(len(D), dtype=np.bool_))


def motions_by_encoder(positions: Float[np.ndarray, "b n 3"], encoder: Float[np.ndarray, "b n"]) -> Motions:
    """Return the motions of positions at the encoder's angles; failed where they do not lie on an arc."""
    A = np.stack([np.ones_like(encoder), np.cos(encoder), np.sin(encoder)], axis=2)
    a, b, e = np.moveaxis(np.linalg.pinv(A) @ positions, 1, 0)
    n = np.cross(b, e)
    length = np.linalg.norm(n, axis=1)
    extent = np.maximum(np.maximum(np.sum(b * b, axis=1), np.sum(e * e, axis=1)), _ROUND)
    none = ~(length > _ROUND * extent)
    return Motions(_placed(a, n / np.where(none, 1.0, length)[:, None], a + b, None, encoder), none)


def motions_by_circle(positions: Float[np.ndarray, "b n 3"], encoder: Float[np.ndarray, "b n"]) -> Motions:
    """Return the motions of positions by the circle through them; the encoder gives its sense and the turns."""
    circles = fit_circles(positions)
    out = positions - circles.centres[:, None]
    middle = np.argmin(np.abs(encoder), axis=1)
    e1 = np.take_along_axis(out, middle[:, None, None], axis=1)[:, 0]
    e1 = e1 - circles.normals * np.sum(circles.normals * e1, axis=1, keepdims=True)
    e1 = e1 / np.maximum(np.linalg.norm(e1, axis=1, keepdims=True), 1e-300)
    best, angles, normals = np.full(len(encoder), np.inf), encoder, circles.normals
    for n in (circles.normals, -circles.normals):
        along, across = ((out @ axis[:, :, None])[:, :, 0] for axis in (e1, np.cross(n, e1)))
        off = _wrapped(np.arctan2(across, along) - encoder)
        shift = np.arctan2(np.sin(off).mean(axis=1), np.cos(off).mean(axis=1))[:, None]
        off = _wrapped(off - shift)
        nearer = np.sum(off**2, axis=1) < best
        best = np.where(nearer, np.sum(off**2, axis=1), best)
        angles = np.where(nearer[:, None], encoder + shift + off, angles)
        normals = np.where(nearer[:, None], n, normals)
    at = circles.centres + circles.radii[:, None] * e1
    return Motions(_placed(circles.centres, normals, at, None, angles), circles.none)


def _logarithms(rotations: Float[np.ndarray, "b n 3 3"]) -> Float[np.ndarray, "b n 3"]:
    return rotation_vectors(rotations.reshape(-1, 3, 3), np.eye(3)).reshape(rotations.shape[:3])


def _along(
    n: Float[np.ndarray, "b 3"], rotations: Float[np.ndarray, "b n 3 3"], encoder: Float[np.ndarray, "b n"]
) -> Float[np.ndarray, "b n"]:
    """Return how much further than the encoder says each pose turned about n, against the mean of all."""
    left = rotations_about(n, -encoder) @ rotations
    mean = nearest_rotation(left.sum(axis=1))
    return np.einsum("bnk,bk->bn", _logarithms(left @ mean[:, None].swapaxes(2, 3)), n)


def _agreement(
    n: Float[np.ndarray, "b 3"], rotations: Float[np.ndarray, "b n 3 3"], encoder: Float[np.ndarray, "b n"]
) -> Float[np.ndarray, " b"]:
    left = rotations_about(n, -encoder) @ rotations
    return np.asarray(np.linalg.norm(left.sum(axis=1), axis=(1, 2)))


def _placed(
    point: Float[np.ndarray, "b 3"],
    direction: Float[np.ndarray, "b 3"],
    position: Float[np.ndarray, "b 3"],
    rotation: Float[np.ndarray, "b 3 3"] | None,
    angles: Float[np.ndarray, "b n"],
) -> Motion:
    """Return motions with their point at the foot of the pose at φ = 0."""
    along = np.sum(direction * (position - point), axis=1, keepdims=True)
    return Motion(point + direction * along, direction, position, rotation, angles)


def _wrapped(angles: Float[np.ndarray, "b n"]) -> Float[np.ndarray, "b n"]:
    return np.asarray((angles + math.pi) % (2.0 * math.pi) - math.pi)


_SPREAD = 1e-9  # of the points along their second direction: below, they are on a line
_CURVATURE = 1e-12


@dataclass(frozen=True, slots=True)
class Circle:
    """Centre and radius in mm; `normal` is of unit length, of either sense."""

    centre: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    radius: float


@dataclass(frozen=True, slots=True)
class Circles:
    """A circle through each of several sets of points; what stands where there is `none` means nothing."""

    centres: Float[np.ndarray, "b 3"]
    normals: Float[np.ndarray, "b 3"]
    radii: Float[np.ndarray, " b"]
    none: Bool[np.ndarray, " b"]


def fit_circle(points: Float[np.ndarray, "n 3"]) -> Circle:
    """Fit a circle to three or more points.

    Raises DegenerateGeometry where the points are one point or lie on one line.
    """
    found = fit_circles(points[None])
    if found.none[0]:
        raise DegenerateGeometry(
            "The positions of a sweep lie on one point or line, where a circle has none to fit.",
            "Mount the camera or reflector away from the joint's axis; or use rotations (method screw or combined); "
            "only turning joints can be identified.",
        )
    return Circle(found.centres[0], found.normals[0], float(found.radii[0]))


def fit_circles(points: Float[np.ndarray, "b n 3"]) -> Circles:
    """Fit a circle to each of several sets of three or more points."""
    mean = points.mean(axis=1)
    _, singular, Vt = np.linalg.svd(points - mean[:, None], full_matrices=False)
    none = ~(singular[:, 1] > _SPREAD * np.maximum(singular[:, 0], 1e-300))
    plane = Vt[:, :2]
    x, y = np.moveaxis((points - mean[:, None]) @ plane.swapaxes(1, 2), 2, 0)
    square = x * x + y * y
    level = np.where(none, 1.0, square.mean(axis=1))
    size = 2.0 * np.sqrt(level)
    scaled = (square - level[:, None]) / size[:, None]
    rows = np.linalg.svd(np.stack([scaled, x, y], axis=2), full_matrices=True)[2]
    a, b, c = rows[:, -1].T
    a = a / size
    none |= np.abs(a) * np.sqrt(level) < _CURVATURE
    centre = np.stack([-b, -c], axis=1) / (2.0 * np.where(none, 1.0, a))[:, None]
    radius = np.sqrt(np.sum(centre**2, axis=1) + level)
    normals = np.cross(plane[:, 0], plane[:, 1])
    return Circles(mean + (centre[:, None] @ plane)[:, 0], normals, radius, none)
