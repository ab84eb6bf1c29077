"""The motion of one joint: an axis, and a pose that turns about it.

    p_k = c + D_k (p_0 - c),     R_k = D_k R_0,     D_k = Rot(n, φ_k)

with the axis through c along n, and (p_0, R_0) the pose at φ = 0. The φ_k are the encoder's, or free: each pose then
determines its own angle, and its residual is the distance from the motion. One model serves all methods: positions with
free angles are the circle (residuals in the plane and out of it); poses with free angles are the screw; poses, or
positions, with the encoder's angles are the combined form.

Derivatives of the prediction, positions and rotation vectors (R_true = exp(w) R), e along the basis (radial e1,
tangential e2, axial n):

    c moved by e ⊥ n           (1 - D) e                            0
    n turned by w about c      w × (D u) - D (w × u)                (1 - D) w          u = p_0 - c
    p_0 moved by v             D v                                  0
    the pose turned by w       D (w × u)                            D w
    φ                          n × (D u)                            n

With free angles turning the pose about n is the same as shifting all angles, so it is no parameter then.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.geometry import hat, rotation_vectors, rotations_about, so3_exp

AXIS_PARAMETERS = 4
"""The first of every step: c along e1 and e2 (mm), n turned about e1 and e2 (rad)."""
_ANGLE_STEPS = 3
_SETTLED = 1e-7  # rad: steps are quadratic, and after such a one nothing is left


@dataclass(frozen=True, slots=True)
class ArcObservations:
    """The poses of one arc, made ready: `whitening` W with W V Wᵀ = 1, `encoder` the angles about their mean, rad."""

    positions: Float[np.ndarray, "n 3"]
    rotations: Float[np.ndarray, "n 3 3"] | None
    encoder: Float[np.ndarray, " n"]
    whitening: Float[np.ndarray, "n m m"]
    free_angles: bool

    @property
    def components(self) -> int:
        """Return the number of residuals of one pose that remain after its angle is determined."""
        return (3 if self.rotations is None else 6) - int(self.free_angles)


@dataclass(frozen=True, slots=True)
class Motion:
    """A state of the fit; `angles` are φ. Of many at once all fields have leading axes, and `residuals`,
    `angle_derivative` and `with_angles` take them; the rest is of one alone.
    """

    point: Float[np.ndarray, "*b 3"]
    direction: Float[np.ndarray, "*b 3"]
    position: Float[np.ndarray, "*b 3"]
    rotation: Float[np.ndarray, "*b 3 3"] | None
    angles: Float[np.ndarray, "*b n"]

    def one(self, index: int) -> Motion:
        """Return one of many."""
        return Motion(
            self.point[index],
            self.direction[index],
            self.position[index],
            None if self.rotation is None else self.rotation[index],
            np.ascontiguousarray(self.angles[index]),
        )

    @property
    def basis(self) -> Float[np.ndarray, "3 3"]:
        """Columns e1 (from the axis to p_0), e2, n."""
        n = self.direction
        out = self.position - self.point
        out = out - n * (n @ out)
        if out @ out < 1e-18:  # on the axis: any direction across it will do
            out = hat(n)[int(np.argmin(np.abs(n)))]
        e1 = out / np.linalg.norm(out)
        return np.array([e1, hat(n) @ e1, n]).T

    @property
    def radius(self) -> float:
        return float(np.linalg.norm(hat(self.direction) @ (self.position - self.point)))

    def moved(self, step: Float[np.ndarray, " p"], seen: ArcObservations) -> Motion:
        """Return the motion after a step of its parameters; the angles follow where they are free."""
        E = self.basis
        point = self.point + E[:, :2] @ step[:2]
        direction = so3_exp(E[:, :2] @ step[2:4]) @ self.direction
        direction /= np.linalg.norm(direction)
        if self.rotation is None:
            shift = np.zeros(3)
            shift[[0, 2] if seen.free_angles else [0, 1, 2]] = step[4:]
            position, rotation = self.position + E @ shift, None
        else:
            turn = np.zeros(3)
            turn[: 2 if seen.free_angles else 3] = step[7:]
            R = so3_exp(E @ turn)
            position = self.point + E @ step[4:7] + R @ (self.position - self.point)
            rotation = R @ self.rotation
        point = point + direction * (direction @ (position - point))
        moved = Motion(point, direction, position, rotation, self.angles)
        return with_angles(moved, seen)


def residuals(motion: Motion, seen: ArcObservations) -> Float[np.ndarray, "*b n m"]:
    """Return measured - predicted of every pose: position (mm), and rotation vector (rad) where there is one."""
    return _residuals(motion, seen, rotations_about(motion.direction, motion.angles))


def _residuals(
    motion: Motion, seen: ArcObservations, D: Float[np.ndarray, "*b n 3 3"]
) -> Float[np.ndarray, "*b n m"]:
    off = seen.positions - motion.point[..., None, :] - _turned(D, motion.position - motion.point)
    if seen.rotations is None or motion.rotation is None:
        return np.asarray(off)
    turn = seen.rotations @ (D @ motion.rotation[..., None, :, :]).swapaxes(-1, -2)
    turns = rotation_vectors(turn.reshape(-1, 3, 3), np.eye(3)).reshape(off.shape)
    return np.concatenate([off, turns], axis=-1)


def angle_derivative(motion: Motion, seen: ArcObservations) -> Float[np.ndarray, "*b n m"]:
    """Return d(prediction)/dφ of every pose."""
    return _angle_derivative(motion, seen, rotations_about(motion.direction, motion.angles))


def _angle_derivative(
    motion: Motion, seen: ArcObservations, D: Float[np.ndarray, "*b n 3 3"]
) -> Float[np.ndarray, "*b n m"]:
    n = motion.direction[..., None, :]
    along = _cross(n, _turned(D, motion.position - motion.point))
    if seen.rotations is None:
        return along
    return np.concatenate([along, np.broadcast_to(n, along.shape)], axis=-1)


def _turned(
    D: Float[np.ndarray, "*b n 3 3"], vector: Float[np.ndarray, "*b 3"]
) -> Float[np.ndarray, "*b n 3"]:
    return np.asarray((D @ vector[..., None, :, None])[..., 0])


def _cross(a: Float[np.ndarray, "*_a 3"], b: Float[np.ndarray, "*_b 3"]) -> Float[np.ndarray, "*_c 3"]:
    x, y, z = (a[..., i] for i in range(3))
    u, v, w = (b[..., i] for i in range(3))
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def jacobian(motion: Motion, seen: ArcObservations) -> Float[np.ndarray, "n m p"]:
    """Return d(prediction)/d(step) of every pose."""
    return _jacobian(motion, seen, rotations_about(motion.direction, motion.angles))


def _jacobian(
    motion: Motion, seen: ArcObservations, D: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "n m p"]:
    E, u = motion.basis, motion.position - motion.point
    e1, e2, n = E.T
    out = D @ u
    across = np.eye(3) - D

    def turned(w: Float[np.ndarray, "3"]) -> Float[np.ndarray, "k 3"]:
        return np.asarray(out @ hat(w).T - D @ (hat(w) @ u))

    zero = np.zeros_like(out)
    if seen.rotations is None:
        shifts = (e1, n) if seen.free_angles else (e1, e2, n)
        columns = [across @ e1, across @ e2, turned(e1), turned(e2), *(D @ v for v in shifts)]
        return np.stack(columns, axis=2)
    turns = (e1, e2) if seen.free_angles else (e1, e2, n)
    position = [across @ e1, across @ e2, turned(e1), turned(e2)]
    position += [D @ v for v in (e1, e2, n)] + [D @ (hat(w) @ u) for w in turns]
    rotation = [zero, zero, across @ e1, across @ e2, zero, zero, zero, *(D @ w for w in turns)]
    return np.concatenate([np.stack(position, axis=2), np.stack(rotation, axis=2)], axis=1)


def with_angles(motion: Motion, seen: ArcObservations) -> Motion:
    """Return the motion with each pose's angle where it agrees best; unchanged where the encoder gives them."""
    if not seen.free_angles:
        return motion
    for _ in range(_ANGLE_STEPS):
        D = rotations_about(motion.direction, motion.angles)
        r = (seen.whitening @ _residuals(motion, seen, D)[..., None])[..., 0]
        g = (seen.whitening @ _angle_derivative(motion, seen, D)[..., None])[..., 0]
        step = np.sum(g * r, axis=-1) / np.maximum(np.sum(g * g, axis=-1), 1e-300)
        # A gross error would send its angle round and round.
        motion = replace(motion, angles=motion.angles + np.clip(step, -1.0, 1.0))
        if np.abs(step).max() < _SETTLED:
            break
    return motion


def linearised(
    motion: Motion, seen: ArcObservations
) -> tuple[Float[np.ndarray, "n r"], Float[np.ndarray, "n r p"], Float[np.ndarray, "n r m"]]:
    """Return whitened residuals, derivatives, and the whitening matrix, with the free angles eliminated.

    With g the whitened derivative by a free angle, a Householder reflection takes g to the last component, which is
    then dropped.
    """
    W, D = seen.whitening, rotations_about(motion.direction, motion.angles)
    if seen.free_angles:
        g = np.einsum("nij,nj->ni", W, _angle_derivative(motion, seen, D))
        v = g / np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-300)
        v[:, -1] += np.where(v[:, -1] < 0.0, -1.0, 1.0)
        scale = 2.0 / np.sum(v * v, axis=1)
        reflection = np.eye(v.shape[1]) - scale[:, None, None] * v[:, :, None] * v[:, None, :]
        W = reflection[:, :-1] @ W
    r = np.einsum("nri,ni->nr", W, _residuals(motion, seen, D))
    return r, W @ _jacobian(motion, seen, D), W
