"""Cycles of several poses on one grid: rows are cycles, columns poses, whitened by each pose's scatter.

Pose i at cycle c deviates from its mean by d_ic with covariance S_i. Whitened, z_ic = S_i^-½ d_ic. A motion u_c that
all poses share (of the camera's mount, of the target, by temperature) is estimated by generalised least squares,

    u_c = A_c⁻¹ Σ_i S_i⁻¹ d_ic,     A_c = Σ_i S_i⁻¹ over the poses visited in cycle c,

and whitened by A_c^½, so that it scatters as one more pose does.

S_i of few cycles is shrunk towards the mean shape of all poses, scaled to its own size. Where the instrument's noise
differs between cycles, deviations are scaled to equal variance first. Both are the same for any order of the cycles.

Reference: O. Ledoit, M. Wolf, J. Multivariate Anal. 88 (2004) 365-411, doi:10.1016/S0047-259X(03)00096-4 (shrinkage).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.metrology.iso9283 import deviations as about_mean

_SHRINKAGE_CYCLES = 4.0
"""The mean shape counts as much as this many cycles."""
_RIDGE = 1e-9
_MIN_SHARED = 0.5


@dataclass(frozen=True, slots=True)
class PoseSeries:
    """Visits to one pose.

    Parameters
    ----------
    positions_mm
        One row a visit.
    cycles
        The number of each visit's cycle; None where the order of the visits is not known.
    frame
        Poses of different frames have no motion in common.
    noise
        Covariance of the instrument at each visit, mm²; None where it is not known.
    """

    positions_mm: Float[np.ndarray, "n 3"]
    cycles: Int[np.ndarray, " n"] | None
    frame: int = 0
    noise: Float[np.ndarray, "n 3 3"] | None = None


@dataclass(frozen=True, slots=True)
class CycleGrid:
    """Deviations of poses over cycles, zero where a pose was not visited.

    `numbers` are the cycles' numbers, or the visits' own where poses share less than half of them (`by_visit`);
    `roots` have S_i^½ and `weights` S_i⁻¹, the latter zero for poses of another frame than most; `common_mm` is u_c and
    `common_covariance` A_c⁻¹.
    """

    numbers: Int[np.ndarray, " n"]
    by_visit: bool
    present: Bool[np.ndarray, "n p"]
    deviations_mm: Float[np.ndarray, "n p 3"]
    whitened: Float[np.ndarray, "n p 3"]
    roots: Float[np.ndarray, "p 3 3"]
    weights: Float[np.ndarray, "p 3 3"]
    common_mm: Float[np.ndarray, "n 3"]
    common_whitened: Float[np.ndarray, "n 3"]
    common_covariance: Float[np.ndarray, "n 3 3"]

    def take(self, poses: Int[np.ndarray, " k"]) -> CycleGrid:
        """Return the grid of these poses alone."""
        seen = self.present[:, poses].any(axis=1)
        return _with_common(
            self.numbers[seen],
            self.by_visit,
            self.present[seen][:, poses],
            self.deviations_mm[seen][:, poses],
            self.whitened[seen][:, poses],
            self.roots[poses],
            self.weights[poses],
        )


def equal_scale(
    deviations: Float[np.ndarray, "n 3"], noise: Float[np.ndarray, "n 3 3"] | None
) -> Float[np.ndarray, "n 3"]:
    """Return deviations scaled to equal variance, where the variance of cycle j is the robot's and tr M_j."""
    if noise is None or len(deviations) < 2:
        return deviations
    own = np.einsum("nii->n", noise)
    robot = max(float((deviations**2).sum()) / (len(deviations) - 1) - float(own.mean()), 0.0)
    total = robot + own
    if not (total > 0.0).all():
        return deviations
    scaled = deviations * np.sqrt(total.mean() / total)[:, None]
    return np.asarray(scaled - scaled.mean(axis=0))


def cycle_grid(series: Sequence[PoseSeries]) -> CycleGrid | None:
    """Return poses with two ordered visits or more on one grid; None for an empty list or without any scatter.

    Every series has `cycles`. Visits that share pose and cycle are averaged.
    """
    if not series:
        return None
    places, numbers, by_visit = _aligned([one.cycles for one in series if one.cycles is not None])
    shape = len(numbers), len(series)
    total, count = np.zeros((*shape, 3)), np.zeros(shape)
    covariance = np.zeros((len(series), 3, 3))
    degrees = np.zeros(len(series))
    for i, (one, place) in enumerate(zip(series, places, strict=True)):
        d = equal_scale(about_mean(one.positions_mm), one.noise)
        np.add.at(total[:, i], place, d)
        np.add.at(count[:, i], place, 1.0)
    present = count > 0.0
    deviations = total / np.maximum(count, 1.0)[..., None]
    degrees = present.sum(axis=0) - 1.0
    mean = deviations.sum(axis=0) / np.maximum(degrees + 1.0, 1.0)[:, None]
    deviations = np.where(present[..., None], deviations - mean, 0.0)
    covariance = np.einsum("npi,npj->pij", deviations, deviations) / np.maximum(degrees, 1.0)[:, None, None]
    sizes = np.einsum("pii->p", covariance)
    if not sizes.any():
        return None
    roots, weights = _whitening(covariance, sizes, degrees)
    whitened = np.einsum("pij,npj->npi", np.linalg.inv(roots), deviations)
    frames = np.array([one.frame for one in series])
    values, counts = np.unique(frames, return_counts=True)
    weights[frames != values[np.argmax(counts)]] = 0.0
    return _with_common(numbers, by_visit, present, deviations, whitened, roots, weights)


def _aligned(
    cycles: Sequence[Int[np.ndarray, " _"]],
) -> tuple[list[Int[np.ndarray, " _"]], Int[np.ndarray, " m"], bool]:
    """Return each visit's row, the rows' numbers, and whether these count visits instead of cycles."""
    numbers = np.unique(np.concatenate(cycles))
    rows = [np.searchsorted(numbers, one) for one in cycles]
    shared = np.mean([len(np.unique(row)) / len(numbers) for row in rows])
    if shared >= _MIN_SHARED:
        return rows, numbers, False
    own = [np.unique(one, return_inverse=True)[1].astype(np.intp) for one in cycles]
    return own, np.arange(1, 1 + max(int(one.max()) + 1 for one in own)), True


def _whitening(
    covariance: Float[np.ndarray, "p 3 3"], sizes: Float[np.ndarray, " p"], degrees: Float[np.ndarray, " p"]
) -> tuple[Float[np.ndarray, "p 3 3"], Float[np.ndarray, "p 3 3"]]:
    """Return S_i^½ and S_i⁻¹; a pose without scatter has that of the others."""
    moving = sizes > 0.0
    sizes = np.where(moving, sizes, sizes[moving].min())
    weight = np.where(moving, degrees, 0.0)
    shape = np.einsum("p,pij->ij", weight / sizes, covariance) / weight.sum()
    share = (weight / (weight + _SHRINKAGE_CYCLES))[:, None, None]
    shrunk = share * covariance + (1.0 - share) * sizes[:, None, None] * shape
    shrunk = shrunk + _RIDGE * sizes[:, None, None] * np.eye(3)
    values, vectors = np.linalg.eigh(shrunk)
    roots = (vectors * np.sqrt(values)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return roots, np.asarray((vectors / values[:, None, :]) @ np.swapaxes(vectors, 1, 2))


def _with_common(
    numbers: Int[np.ndarray, " n"],
    by_visit: bool,
    present: Bool[np.ndarray, "n p"],
    deviations: Float[np.ndarray, "n p 3"],
    whitened: Float[np.ndarray, "n p 3"],
    roots: Float[np.ndarray, "p 3 3"],
    weights: Float[np.ndarray, "p 3 3"],
) -> CycleGrid:
    information = np.einsum("np,pij->nij", present.astype(float), weights)
    moment = np.einsum("pij,npj->ni", weights, deviations)
    values, vectors = np.linalg.eigh(information)
    known = values > 0.0
    inverse = np.where(known, 1.0 / np.where(known, values, 1.0), 0.0)
    along = np.einsum("nij,ni->nj", vectors, moment)
    common = np.einsum("nij,nj->ni", vectors, along * inverse)
    common_whitened = np.einsum("nij,nj->ni", vectors, along * np.sqrt(inverse))
    covariance = (vectors * inverse[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return CycleGrid(
        numbers,
        by_visit,
        present,
        deviations,
        whitened,
        roots,
        weights,
        common,
        common_whitened,
        np.asarray(covariance),
    )
