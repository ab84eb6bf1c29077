"""Variance of the mean pose of several visits, an axis: from the visits' scatter, or what the instrument states."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from core.geometry import rotation_vectors, transform, transform_mean
from core.metrology import CycleProcess, mean_of_cycles
from core.session.model import MeasuredPose


def mean_position_variance(
    poses: Sequence[Sequence[MeasuredPose]], process: CycleProcess | None = None
) -> float:
    """Return u² of mean positions along an axis, mm², the mean over the poses.

    The scatter of all poses together gives that of one visit; where no pose has two visits, the covariances that
    differ from visit to visit do, and without these it is 0. `process` is what the visits follow, None for
    independent ones.
    """
    about = [np.array([v.position_mm for v in visits]) for visits in poses]
    return _mean_variance(about, poses, slice(0, 3), process)


def mean_rotation_variance(
    poses: Sequence[Sequence[MeasuredPose]], process: CycleProcess | None = None
) -> float:
    """Return u² of mean orientations about an axis, rad², as `mean_position_variance`; every visit has a rotation."""
    about = []
    for visits in poses:
        rotations = np.array([v.rotation for v in visits if v.rotation is not None])
        mean = transform_mean(np.array([transform(R, np.zeros(3)) for R in rotations]))
        about.append(rotation_vectors(rotations, mean[:3, :3]))
    return _mean_variance(about, poses, slice(3, 6), process)


def _mean_variance(
    values: Sequence[Float[np.ndarray, "_ 3"]],
    poses: Sequence[Sequence[MeasuredPose]],
    part: slice,
    process: CycleProcess | None,
) -> float:
    counts = np.array([len(v) for v in values])
    freedom = 3 * int(np.sum(counts - 1))
    if freedom > 0:
        squares = sum(float(np.sum((v - v.mean(axis=0)) ** 2)) for v in values)
        inflation = np.array(
            [mean_of_cycles(process, n).inflation if n > 1 else 1.0 for n in counts.tolist()]
        )
        return squares / freedom * float(np.mean(inflation**2 / counts))
    scatter = [
        np.trace(v.scatter[part, part]) / 3.0 for visits in poses for v in visits if v.scatter is not None
    ]
    return float(np.mean(scatter)) if scatter else 0.0


def mean_degrees_of_freedom(poses: Sequence[Sequence[MeasuredPose]]) -> float | None:
    """Return those of `mean_position_variance`; None where the scatter is not that of visits."""
    return 3.0 * sum(len(visits) - 1 for visits in poses) or None
