"""The visits of one pose: as arrays, and the images of each stop of the robot as one visit.

Images of one pose, cycle, target and focus group are of one stop where one of the pose and cycle has a `burst` index
above 1; without an index it is 1. A stop counts once, as the mean of its images; the mean's noise is theirs over their
number. Where no index is above 1, each image is a stop of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from core.geometry import rotation_mean
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


def images_of(visit: MeasuredPose) -> tuple[MeasuredPose, ...]:
    """Return the images of a visit: those of its burst, or itself."""
    return visit.burst or (visit,)


def stop_mean(images: Sequence[MeasuredPose]) -> MeasuredPose:
    """Return the mean of the images of one stop, under the first one's id; a single image is returned as it is."""
    if len(images) == 1:
        return images[0]
    first, n = images[0], len(images)
    scatter = stack_all(one.scatter for one in images)
    common = mean_common(images)
    own = own_covariances(images)
    covariance = None if own is None else np.sum(own, axis=0) / n**2
    if covariance is not None and common is not None:
        covariance = covariance + common @ common.T
    rotations = rotations_of(images)
    rms = [one.rms_px for one in images if one.rms_px is not None]
    return replace(
        first,
        position_mm=np.mean([one.position_mm for one in images], axis=0),
        rotation=None if rotations is None else rotation_mean(rotations),
        covariance=covariance,
        scatter=None if scatter is None else np.sum(scatter, axis=0) / n**2,
        common=common,
        rms_px=math.sqrt(float(np.mean(np.square(rms)))) if rms else None,
        burst=tuple(images),
    )


def burst_stops(visits: Iterable[MeasuredPose]) -> set[tuple[str, int | None]]:
    """Return pose and cycle of the stops that state several images."""
    return {
        (visit.pose_id, visit.cycle)
        for visit in visits
        if visit.image is not None and (visit.image.burst or 1) > 1 and visit.cycle is not None
    }


def merge_bursts(visits: Sequence[MeasuredPose]) -> list[MeasuredPose]:
    """Return visits, the images of each stop as one, in the order of their first images.

    Images of different focus groups stay apart: their cameras have errors of their own, by which their poses differ.
    """
    several = burst_stops(visits)
    stops: dict[object, list[MeasuredPose]] = {}
    for place, visit in enumerate(visits):
        stop = visit.pose_id, visit.cycle
        camera = None if visit.image is None else visit.image.focus_group
        stops.setdefault((stop, visit.frame, camera) if stop in several else place, []).append(visit)
    return [stop_mean(images) for images in stops.values()]
