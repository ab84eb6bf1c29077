"""Where the fit of an arc starts when some of its poses may be wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from core.errors import DegenerateGeometry
from core.kinematics.arc import Measured, Motion, residuals, with_angles
from core.kinematics.screw import motion_by_circle, motion_by_encoder, motion_by_rotations

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
    m = 3 if rotations is None else 6
    extent = float(np.linalg.norm(np.ptp(positions, axis=0)))
    arm = max(extent / max(float(np.ptp(encoder)), 0.1), 1.0)
    unit = np.diag(([1.0] * 3 + [arm] * 3)[:m])  # a rotation counts as what it moves at the arm's length
    seen = Measured(positions, rotations, encoder, np.broadcast_to(unit, (len(positions), m, m)), free_angles)

    def lengths(motion: Motion) -> Float[np.ndarray, " n"]:
        return np.asarray(np.linalg.norm(residuals(of_all(motion), seen) @ unit, axis=1))

    def of_all(motion: Motion) -> Motion:
        whole = len(motion.angles) == len(encoder)
        return with_angles(motion if whole else replace(motion, angles=encoder), seen)

    everything = _closed_form(positions, rotations, encoder, free_angles)
    off = lengths(everything)
    if len(positions) <= _SUBSET + 1 or float(off.max()) <= _SLIGHT * extent:
        return of_all(everything)
    best, least = everything, float(np.median(off))
    rng = np.random.default_rng(0)
    for _ in range(_SUBSETS):
        some = np.sort(rng.permutation(len(positions))[:_SUBSET])
        try:
            turns = None if rotations is None else rotations[some]
            candidate = _closed_form(positions[some], turns, encoder[some], free_angles)
        except DegenerateGeometry:
            continue
        median = float(np.median(lengths(candidate)))
        if median < least:
            best, least = candidate, median
    return of_all(best)


def _closed_form(
    positions: Float[np.ndarray, "n 3"],
    rotations: Float[np.ndarray, "n 3 3"] | None,
    encoder: Float[np.ndarray, " n"],
    free_angles: bool,
) -> Motion:
    if rotations is not None:
        return motion_by_rotations(positions, rotations, encoder, free_angles=free_angles)
    return motion_by_circle(positions, encoder) if free_angles else motion_by_encoder(positions, encoder)
