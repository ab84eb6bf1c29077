"""Where the fit of an arc starts when some of its poses may be wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from core.errors import DegenerateGeometry
from core.kinematics.arc import Measured, Motion, residuals, with_angles
from core.kinematics.screw import Motions, motions_by_circle, motions_by_encoder, motions_by_rotations

_SLIGHT = 2e-3
"""Of the arc's extent: where no pose is off by more, wrong ones among them cannot lead the robust fit astray."""
_SUBSET, _SUBSETS = 4, 80


def robust_start(
    positions: Float[np.ndarray, "n 3"],
    rotations: Float[np.ndarray, "n 3 3"] | None,
    encoder: Float[np.ndarray, " n"],
    *,
    free_angles: bool,
) -> Motion:
    """Return the closed form of all poses, or that of a few whose median residual is least where some look wrong.

    Raises DegenerateGeometry where positions do not tell an axis.
    """
    count, m = len(positions), 3 if rotations is None else 6
    extent = float(np.linalg.norm(np.ptp(positions, axis=0)))
    arm = max(extent / max(float(np.ptp(encoder)), 0.1), 1.0)
    unit = np.diag(([1.0] * 3 + [arm] * 3)[:m])  # a rotation counts as what it moves at the arm's length
    seen = Measured(positions, rotations, encoder, np.broadcast_to(unit, (count, m, m)), free_angles)

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
            "The positions of a sweep do not go round an axis: they lie on one point or line.",
            "Mount the camera or reflector away from the joint's axis, and check that the joint turns; or use "
            "rotations (method screw or combined).",
        )
    motion = of_all(everything.all)
    off = lengths(motion)[0]
    if count <= _SUBSET + 1 or float(off.max()) <= _SLIGHT * extent:
        return motion.one(0)
    rng = np.random.default_rng(0)
    some = np.array([np.sort(rng.permutation(count)[:_SUBSET]) for _ in range(_SUBSETS)])
    candidates = _closed_forms(seen, some)
    motions = of_all(candidates.all)
    medians = np.where(candidates.none, np.inf, np.median(lengths(motions), axis=1))
    best = int(np.argmin(medians))
    return motions.one(best) if medians[best] < float(np.median(off)) else motion.one(0)


def _closed_forms(seen: Measured, members: np.ndarray) -> Motions:
    """Return the motions of sets of an arc's poses, `members` (b, n)."""
    positions, encoder = seen.positions[members], seen.encoder[members]
    if seen.rotations is not None:
        return motions_by_rotations(positions, seen.rotations[members], encoder, free_angles=seen.free_angles)
    return (motions_by_circle if seen.free_angles else motions_by_encoder)(positions, encoder)
