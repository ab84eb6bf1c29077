"""The visits of one pose as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from core.metrology import PoseCycles
from core.session.model import MeasuredPose


def stack_all(values: Iterable[np.ndarray | None]) -> np.ndarray | None:
    """Return arrays of one shape as one array; None where one of them is missing."""
    rows = list(values)
    known = [row for row in rows if row is not None]
    return np.array(known) if len(known) == len(rows) else None


def positions_of(visits: Sequence[MeasuredPose]) -> Float[np.ndarray, "n 3"]:
    """Return the positions, mm."""
    return np.array([visit.position_mm for visit in visits])


def rotations_of(visits: Sequence[MeasuredPose]) -> Float[np.ndarray, "n 3 3"] | None:
    """Return the rotations; None where a visit has none."""
    return stack_all(visit.rotation for visit in visits)


def own_covariances(visits: Sequence[MeasuredPose]) -> Float[np.ndarray, "n 6 6"] | None:
    """Return the covariances without what all images share; None where a visit has none."""
    return stack_all(visit.own_covariance() for visit in visits)


def mean_common(visits: Sequence[MeasuredPose]) -> Float[np.ndarray, "6 e"] | None:
    """Return what the errors that all images share do to the mean; None where a visit does not have it."""
    common = [visit.common for visit in visits if visit.common is not None]
    if len(common) < len(visits):
        return None
    if all(one is common[0] for one in common):
        return common[0]  # visits of an absolute pose share one array, which is kept: distances compare it
    return np.mean(common, axis=0)


def cycles_of(visits: Sequence[MeasuredPose]) -> PoseCycles:
    """Return a pose's cycles; orientations and covariances where every one of them has them."""
    return PoseCycles(
        positions_of(visits), rotations_of(visits), stack_all(visit.scatter for visit in visits)
    )
