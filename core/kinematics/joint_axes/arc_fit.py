"""The fit of one arc at given variances of the robot and given errors of the lens, and its robust start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.errors import DegenerateGeometry, NotConverged
from core.geometry import so3_exp
from core.kinematics.joint_axes.arc_model import (
    ArcObservations,
    Motion,
    angle_derivative,
    jacobian,
    linearised,
    residuals,
    with_angles,
)
from core.kinematics.joint_axes.closed_form import (
    Motions,
    motions_by_circle,
    motions_by_encoder,
    motions_by_rotations,
)
from core.kinematics.pose_observations import PoseData
from core.kinematics.sweeps import Sweep
from core.numerics import LinearResiduals, Variances, best_subset, fit, weights

UNITS = Variances(1.0, 1e-6)
"""The variances assumed at the start: a millimetre weighs as much as a milliradian."""
_EXACT = 1e-3  # in units of the noise assumed


class ArcProblem:
    """One arc's poses, weights and motion, refined in place as the weights become known."""

    def __init__(
        self,
        sweep: Sweep,
        positions: Float[np.ndarray, "n 3"],
        rotations: Float[np.ndarray, "n 3 3"] | None,
        own: Float[np.ndarray, "n m m"],
        common: Float[np.ndarray, "n m k"],
        free_angles: bool,
    ) -> None:
        self.sweep, self.positions, self.rotations = sweep, positions, rotations
        self.own, self.common, self.free_angles = own, common, free_angles
        self.encoder = sweep.angles - 0.5 * (sweep.angles[0] + sweep.angles[-1])
        self.used = np.ones(len(positions), dtype=np.bool_)
        self.motion: Motion
        self.seen: ArcObservations

    @classmethod
    def prepared(cls, poses: PoseData, sweep: Sweep, method: str) -> ArcProblem:
        members, n = sweep.poses, len(sweep.poses)
        with_rotations = poses.rotations is not None and method != "cpa"
        m = 6 if with_rotations else 3
        own = np.zeros((n, m, m)) if poses.covariance is None else poses.covariance[members, :m, :m]
        common = np.zeros((n, m, 0)) if poses.common is None else poses.common[members, :m]
        rotations = poses.rotations[members] if with_rotations and poses.rotations is not None else None
        return cls(sweep, poses.positions_mm[members], rotations, own, common, method != "combined")

    def resume(self, motion: Motion, used: Bool[np.ndarray, " n"]) -> None:
        """Start where the same poses, moved by little or by nothing, were fitted before."""
        self.motion, self.used = motion, used.copy()

    def start(self) -> None:
        self.motion = robust_start(self.positions, self.rotations, self.encoder, free_angles=self.free_angles)
        self._look(weights(np.zeros_like(self.own), UNITS), np.zeros(self.common.shape[2]))

    def refine(self, variances: Variances, shared: Float[np.ndarray, " k"], *, robust: bool) -> None:
        self._look(weights(self.own, variances), shared)
        seen = self.seen

        def evaluate(motion: Motion) -> tuple[Float[np.ndarray, "r n"], Float[np.ndarray, "p r n"]]:
            r, J, _ = linearised(motion, seen)
            return np.ascontiguousarray(r.T), np.ascontiguousarray(J.transpose(2, 1, 0))

        found = fit(
            evaluate,
            lambda motion, step: motion.moved(step, seen),
            with_angles(self.motion, seen),
            np.ones(len(self.positions)),
            smallest_scale=_EXACT,
            used=None if robust else self.used,
        )
        joint = self.sweep.joint + 1
        if found.status == "singular":
            raise DegenerateGeometry(
                f"The sweep of joint {joint} does not determine its axis: too few poses remain, or they lie on it.",
                "Sweep a longer arc with more poses, with the camera away from the joint's axis.",
            )
        if not robust and not found.converged and self.rotations is None:
            raise DegenerateGeometry(
                f"The axis of joint {joint} could not be fitted: the positions of its sweep hardly lie on an arc.",
                "Mount the camera or reflector away from the joint's axis, or sweep a longer arc; or use rotations "
                "(method screw or combined).",
            )
        if not robust and not found.converged:
            raise NotConverged(
                f"The axis of joint {joint} could not be fitted: its poses do not lie on an arc.",
                "Check that these poses carry the right joint angles and show the right target.",
            )
        self.motion = found.state

    def linear(self) -> LinearResiduals:
        """Return what is left, unwhitened, of the poses that count."""
        return LinearResiduals(
            self.own[self.used],
            residuals(self.motion, self.seen)[self.used],
            jacobian(self.motion, self.seen)[self.used],
            angle_derivative(self.motion, self.seen)[self.used] if self.free_angles else None,
        )

    def whitened(
        self,
    ) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"], Float[np.ndarray, "q k"]]:
        """Return residuals, derivatives by the arc's parameters and by the shared errors, of the poses that count."""
        r, J, W = linearised(self.motion, self.seen)
        C = W @ self.common
        r, J, C = r[self.used], J[self.used], C[self.used]
        return r.ravel(), J.reshape(-1, J.shape[2]), C.reshape(r.size, C.shape[2])

    def distances(self) -> Float[np.ndarray, " n"]:
        """Return the squared length of each pose's whitened residual."""
        return np.asarray(np.sum(linearised(self.motion, self.seen)[0] ** 2, axis=1))

    def _look(self, W: Float[np.ndarray, "n m m"], shared: Float[np.ndarray, " k"]) -> None:
        """Take the poses as measured, less what the shared errors did to them."""
        positions, rotations = self.positions, self.rotations
        if shared.any():
            error = self.common @ shared
            positions = positions - error[:, :3]
            if rotations is not None:
                rotations = np.array([so3_exp(-w) for w in error[:, 3:]]) @ rotations
        self.seen = ArcObservations(positions, rotations, self.encoder, W, self.free_angles)


_SLIGHT = 2e-3
"""Of the arc's extent: where no pose is off by more, outliers cannot mislead the robust fit."""
_SUBSET, _SUBSETS = 4, 80


def robust_start(
    positions: Float[np.ndarray, "n 3"],
    rotations: Float[np.ndarray, "n 3 3"] | None,
    encoder: Float[np.ndarray, " n"],
    *,
    free_angles: bool,
) -> Motion:
    """Return the closed form of all poses, or that of a few whose median residual is least where some look wrong.

    Raises DegenerateGeometry where positions do not determine an axis.
    """
    count, m = len(positions), 3 if rotations is None else 6
    extent = float(np.linalg.norm(np.ptp(positions, axis=0)))
    arm = max(extent / max(float(np.ptp(encoder)), 0.1), 1.0)
    unit = np.diag(([1.0] * 3 + [arm] * 3)[:m])  # a rotation counts as what it moves at the arm's length
    seen = ArcObservations(positions, rotations, encoder, np.broadcast_to(unit, (count, m, m)), free_angles)

    def of_all(some: Motion) -> Motion:
        """Motions of some poses, taken to all: each at its encoder's angle, or free to turn from there."""
        angles = some.angles
        if angles.shape[1] != count:
            angles = np.broadcast_to(encoder, (len(some.point), count))
        return with_angles(replace(some, angles=angles), seen)

    def lengths(motions: Motion) -> Float[np.ndarray, "b n"]:
        return np.asarray(np.linalg.norm(residuals(motions, seen) @ unit, axis=2))

    everything = _closed_forms(seen, np.arange(count)[None])
    if everything.none[0]:
        raise DegenerateGeometry(
            "The positions of a sweep are not an arc: they lie on one point or line.",
            "Mount the camera or reflector away from the joint's axis, and check that the joint turns; or use "
            "rotations (method screw or combined).",
        )
    motion = of_all(everything.all)
    off = lengths(motion)[0]
    if count <= _SUBSET + 1 or float(off.max()) <= _SLIGHT * extent:
        return motion.one(0)

    def of_sets(sets: Int[np.ndarray, "s k"]) -> Float[np.ndarray, "s 1 n"]:
        candidates = _closed_forms(seen, sets)
        found = np.where(candidates.none[:, None], np.inf, lengths(of_all(candidates.all)))
        return np.asarray(found[:, None])

    chosen = best_subset(of_sets, off[None], size=_SUBSET, number=_SUBSETS)
    return motion.one(0) if chosen is None else of_all(_closed_forms(seen, chosen[None]).all).one(0)


def _closed_forms(seen: ArcObservations, members: np.ndarray) -> Motions:
    """Return the motions of sets of an arc's poses, `members` (b, n)."""
    positions, encoder = seen.positions[members], seen.encoder[members]
    if seen.rotations is not None:
        return motions_by_rotations(positions, seen.rotations[members], encoder, free_angles=seen.free_angles)
    return (motions_by_circle if seen.free_angles else motions_by_encoder)(positions, encoder)
