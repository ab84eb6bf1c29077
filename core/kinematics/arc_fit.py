"""The fit of one arc, at given variances of the robot and given errors of the lens."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from core.errors import DegenerateGeometry, NotConverged
from core.kinematics.arc import (
    Measured,
    Motion,
    angle_derivative,
    jacobian,
    linearised,
    residuals,
    with_angles,
)
from core.kinematics.arc_noise import ArcResiduals, Variances, weights
from core.kinematics.arc_start import robust_start
from core.kinematics.poses import PoseData
from core.kinematics.sweeps import Sweep
from core.least_squares import fit
from core.transforms import so3_exp

UNITS = Variances(1.0, 1e-6)
"""What is assumed before anything is known: a millimetre weighs as much as a milliradian."""
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
        self.seen: Measured

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
                f"The sweep of joint {joint} does not tell its axis: too few poses are left, or they lie on it.",
                "Sweep a longer arc with more poses, with the camera away from the joint's axis.",
            )
        if not robust and not found.converged and self.rotations is None:
            raise DegenerateGeometry(
                f"The positions of joint {joint}'s sweep do not settle on an axis: they hardly go round one.",
                "Mount the camera or reflector away from the joint's axis, or sweep a longer arc; or use rotations "
                "(method screw or combined).",
            )
        if not robust and not found.converged:
            raise NotConverged(
                f"The axis of joint {joint} does not settle: its poses do not go round.",
                "Check that these poses carry the right joint angles and show the right target.",
            )
        self.motion = found.state

    def linear(self) -> ArcResiduals:
        """Return what is left, unwhitened, of the poses that count."""
        return ArcResiduals(
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
        self.seen = Measured(positions, rotations, self.encoder, W, self.free_angles)
