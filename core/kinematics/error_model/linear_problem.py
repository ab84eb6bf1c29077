"""The linearised problem of the error model: distinct configurations, their whitened rows, sums over blocks of them.

Visits to one joint configuration share whatever the model lacks there. Their rows and residuals are averaged, so that
what is left of noise is the noise of a configuration, and none counts twice.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import blas
from scipy.sparse import csr_array

from core.kinematics.arm_model import NOMINAL_ANGLE_RAD, NOMINAL_LENGTH_MM, ArmState
from core.kinematics.error_model.evidence import Fitted, Prior, Sums
from core.kinematics.error_model.terms import ALONG_Z, Kind, Terms, term_columns, terms_of
from core.kinematics.global_fit import Observations, configurations, linearised, whitened, whitener
from core.numerics import Variances

_BLOCK = 128  # configurations whose rows are in memory at a time: some 5 MB for six joints
_CONTRADICTION = 1.5
"""Rms deviation from the nominal, in prior standard deviations, beyond which the prior is widened to it."""


Rows = tuple[Int[np.ndarray, " q"], Float[np.ndarray, "p m q"]]
"""Configurations by their indices, and the derivatives of their predictions by all coefficients."""


@dataclass(frozen=True, slots=True)
class Design:
    """An arm, its distinct configurations, and the columns that are fitted.

    `seen` are the configurations (means of their visits), `residuals` observed - predicted there; `of_poses` are those
    of the poses themselves and `visit` their configurations; `free` are the columns of the layout, shared errors
    included.
    """

    arm: ArmState
    seen: Observations
    residuals: Float[np.ndarray, "m n"]
    of_poses: Float[np.ndarray, "m v"]
    visit: Int[np.ndarray, " v"]
    free: Bool[np.ndarray, " p"]
    prior: Prior
    terms: Terms
    gravity: Float[np.ndarray, "3"]
    """Its direction in the base, up or down."""

    def __len__(self) -> int:
        return len(self.seen)

    @property
    def kinds(self) -> int:
        """Positions and rotations, or positions alone."""
        return self.seen.components // 3

    def at(self, joint_angles: Float[np.ndarray, "n j"], *, components: int) -> Design:
        """Return the problem at other joint angles (rad) before the first target, of which nothing was observed: for
        its rows, of 6 components or 3.
        """
        n, m = len(joint_angles), components
        seen = Observations(
            np.ascontiguousarray(joint_angles, dtype=np.float64),
            np.zeros((n, 3)),
            None if m == 3 else np.broadcast_to(np.eye(3), (n, 3, 3)),
            np.zeros((n, m, m)),
            np.zeros((n, m, self.seen.common.shape[2])),
            np.zeros(n, dtype=np.intp),
        )
        return replace(self, seen=seen)

    def by_unknown_moves(self, members: Int[np.ndarray, " q"], fitted: Fitted) -> Float[np.ndarray, "m q"]:
        """Return the variances of predictions by last moves that are as probable to one side as to the other."""
        some = self.seen.take(members)
        of_moves = self.terms.of(Kind.APPROACH)
        if not of_moves.any():
            return np.zeros((some.components, len(members)))
        places = int(self.free.sum()) + np.flatnonzero(of_moves)
        squares = fitted.coefficients[places] ** 2 + np.diag(fitted.covariance)[places]
        either = np.ones_like(some.joint_angles)
        columns = term_columns(self.arm, some.joint_angles, some.target, either, gravity=self.gravity)[
            of_moves, : some.components
        ]
        return np.asarray(np.einsum("jmn,j->mn", columns**2, squares))

    def rows(self, members: Int[np.ndarray, " q"]) -> Float[np.ndarray, "p m q"]:
        """Return the derivatives of predictions by all coefficients, not whitened."""
        some = self.seen.take(members)
        _, J = linearised(self.arm, some)
        moves = None
        if self.terms.of(Kind.APPROACH).any():
            moves = np.zeros_like(some.joint_angles) if some.approach is None else some.approach
        chain = int(self.free.sum())
        found = np.empty((chain + len(self.terms), *J.shape[1:]))
        found[:chain] = J[self.free]
        term_columns(self.arm, some.joint_angles, some.target, moves, gravity=self.gravity, out=found[chain:])
        return found

    def blocks(self, members: Int[np.ndarray, " n"]) -> Iterator[Int[np.ndarray, " q"]]:
        """Yield the members in blocks that fit in memory."""
        for first in range(0, len(members), _BLOCK):
            yield members[first : first + _BLOCK]

    def with_rows(self, members: Int[np.ndarray, " n"]) -> Iterator[Rows]:
        """Yield the members in blocks that fit in memory, each with its rows."""
        for some in self.blocks(members):
            yield some, self.rows(some)

    def sums(
        self, members: Int[np.ndarray, " q"], scatter: Variances, blocks: Iterable[Rows] | None = None
    ) -> Sums:
        """Return the sums over these configurations, whitened by their covariances and this scatter.

        `blocks` are the configurations with their rows, where these are known.
        """
        k, p = self.kinds, int(self.free.sum()) + len(self.terms)
        normal, gradient, squares = np.zeros((k, p, p)), np.zeros((k, p)), np.zeros(k)
        W = whitener(self.seen, scatter)
        for some, rows in self.with_rows(members) if blocks is None else blocks:
            X = whitened(W[:, :, some], rows)
            y = whitened(W[:, :, some], self.residuals[:, some])
            for kind in range(k):
                part = slice(3 * kind, 3 * kind + 3)
                flat = X[:, part].reshape(p, -1)
                left = y[part].ravel()
                # In place, and one triangle alone: a product of its own and its sum would take as long again.
                blas.dsyrk(1.0, flat.T, beta=1.0, c=normal[kind].T, trans=1, overwrite_c=1)
                gradient[kind] += flat @ left
                squares[kind] += left @ left
        for of_kind in normal:
            of_kind += np.tril(of_kind, -1).T
        return Sums(normal, gradient, squares, np.full(k, 3.0 * len(members)))

    def left(self, coefficients: Float[np.ndarray, " p"]) -> Float[np.ndarray, "m n"]:
        """Return the residuals of all configurations after a step of all coefficients."""
        found = self.residuals.copy()
        for some, rows in self.with_rows(np.arange(len(self))):
            found[:, some] -= np.einsum("pmn,p->mn", rows, coefficients)
        return found


def design(
    arm: ArmState,
    seen: Observations,
    free: Bool[np.ndarray, " p"],
    nominal: Float[np.ndarray, "j 5"] | None,
    labels: Sequence[str] = (),
) -> Design:
    """Linearise at an arm; its DH parameters are normal about the `nominal`, or flat without one."""
    layout = arm.layout
    taken = free.copy()
    taken[layout.kinematic :] = True
    residuals, _ = linearised(arm, seen)
    averaged, means, visit = _averaged(seen, residuals, labels)
    prior = _prior(arm, taken, nominal)
    moves_known = averaged.approach is not None and bool(averaged.approach.any())
    terms = terms_of(layout.joints, approach=moves_known)
    return Design(arm, averaged, means, residuals, visit, taken, prior, terms, ALONG_Z)


def _prior(arm: ArmState, free: Bool[np.ndarray, " p"], nominal: Float[np.ndarray, "j 5"] | None) -> Prior:
    layout = arm.layout
    variances, means = np.full(layout.size, np.inf), np.zeros(layout.size)
    variances[layout.kinematic :] = 1.0
    means[layout.kinematic :] = -arm.shared
    if nominal is not None:
        off = nominal - arm.parameters
        fitted = free[: off.size].reshape(off.shape)
        v = np.empty_like(off)
        for parameters, spread in (([0, 2], NOMINAL_LENGTH_MM), ([1, 3, 4], NOMINAL_ANGLE_RAD)):
            deviations = off[:, parameters][fitted[:, parameters]] / spread
            size = float(np.sqrt(np.mean(deviations**2))) if len(deviations) else 0.0
            v[:, parameters] = (spread * (size if size > _CONTRADICTION else 1.0)) ** 2
        variances[: off.size], means[: off.size] = v.ravel(), off.ravel()
    return Prior(variances[free], means[free])


def _averaged(
    seen: Observations, residuals: Float[np.ndarray, "m n"], labels: Sequence[str]
) -> tuple[Observations, Float[np.ndarray, "m a"], Int[np.ndarray, " n"]]:
    """Return distinct configurations before each target, their residuals, and the configuration of each pose.

    Means of residuals: a position averaged over visits, whose angles differ by a little, would not belong to the mean
    of the angles, its residual does.
    """
    group = configurations(seen.joint_angles, labels) * seen.layout.targets + seen.target
    _, first, visit, visits = np.unique(group, return_index=True, return_inverse=True, return_counts=True)
    n = len(seen)
    mean = csr_array((1.0 / visits[visit], (visit, np.arange(n))), shape=(len(first), n))
    m = seen.components
    return (
        replace(
            seen.take(first),
            joint_angles=mean @ seen.joint_angles,
            own=(mean @ seen.own.reshape(n, m * m)).reshape(-1, m, m) / visits[:, None, None],
            common=(mean @ seen.common.reshape(n, -1)).reshape(len(first), m, -1),
            approach=None if seen.approach is None else mean @ seen.approach,
        ),
        np.ascontiguousarray((mean @ residuals.T).T),
        visit,
    )
