"""What poses tell of one another: distances between them, and one pose approached from several sides.

Both need poses in one frame; distances also need visits numbered by cycle, since a cycle's distance is between the two
poses of that cycle. A length is the same in every frame, but it is the measured point's: it compares with the commanded
one where the robot was told the same orientation at both ends, so that all points of the flange move alike.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

from app.services.analyses.estimation import EstimatedImage
from app.services.analyses.pose_rows import AnyVisit, Row, Visit, figure_fields
from app.services.analyses.snapshot import Commanded
from core import Advisory
from core.metrology import (
    DistanceAssessment,
    PoseCycles,
    assess_approaches,
    assess_distance,
)
from core.transforms import rpy_to_rotation, so3_log

MOST_PAIRS = 45
"""All pairs of ten poses; of more poses, each with the next."""
SAME_TURN = np.radians(0.001)
NAMED = 5


@dataclass(frozen=True, slots=True)
class Reading:
    """One visit as distances need it; `frame` tells frames apart that do not compare."""

    cycle: int | None
    position_mm: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"] | None
    scatter: Float[np.ndarray, "6 6"] | None
    common: Float[np.ndarray, "6 k"] | None
    frame: int


@dataclass(frozen=True, slots=True)
class Performance:
    """The two parts of the document, None where they cannot be given, and the reasons."""

    distances: list[dict[str, Any]] | None
    approach_variation: list[dict[str, Any]] | None
    warnings: tuple[Advisory, ...]


def of_image(image: EstimatedImage) -> Reading:
    """Return an image's estimate: what scatters from cycle to cycle, and what all images of the lens share."""
    return Reading(
        image.cycle, image.position_mm, image.rotation, image.scatter, image.common, image.image.target
    )


def of_visit(visit: Visit) -> Reading:
    """Return another instrument's reading; what its readings have in common is not known."""
    return Reading(visit.cycle, visit.position_mm, visit.rotation, visit.covariance, None, 0)


def assess_performance(
    rows: Sequence[Row[AnyVisit]],
    commanded: Mapping[str, Commanded],
    reading: Callable[[AnyVisit], Reading],
) -> Performance:
    """Return distances between poses and variation over approaches, of the visits that count."""
    readings = {row.pose_id: [reading(visit) for visit in row.images] for row in rows if row.images}
    warnings: list[Advisory] = []
    distances = _distances(readings, commanded, warnings)
    approaches = _approaches(readings, commanded, warnings)
    return Performance(distances, approaches, tuple(warnings))


def _distances(
    readings: Mapping[str, list[Reading]], commanded: Mapping[str, Commanded], warnings: list[Advisory]
) -> list[dict[str, Any]] | None:
    poses = list(readings)
    pairs = list(combinations(poses, 2)) if len(poses) * (len(poses) - 1) // 2 <= MOST_PAIRS else None
    if pairs is None:
        pairs = list(pairwise(poses))[:MOST_PAIRS]
        warnings.append(
            Advisory(
                "distances_bounded",
                f"Of {len(poses)} poses, distances are given between {len(pairs)} pairs of successive ones, of all "
                f"pairs where there are no more than {MOST_PAIRS}.",
                "Put the poses whose distances matter into a session of their own.",
            )
        )
    numbered = {pose_id: _by_cycle(visits) for pose_id, visits in readings.items()}
    documents: list[dict[str, Any]] = []
    turned: list[str] = []
    for one, other in pairs:
        first, second = numbered[one], numbered[other]
        shared = [c for c in first if c in second]
        if len(shared) < 2 or first[shared[0]].frame != second[shared[0]].frame:
            continue
        at = [first[c] for c in shared], [second[c] for c in shared]
        same = _same_turn(commanded.get(one), commanded.get(other), at)
        places = [_position(commanded.get(pose_id)) for pose_id in (one, other)]
        told = all(place is not None for place in places)
        if told and not same:
            turned.append(f"{one}-{other}")
        told = told and same
        found = _assess(at, places[0] if told else None, places[1] if told else None)
        if found is not None:
            documents.append(_distance_document(one, other, found, places if told else None))
    if turned:
        more = f" and {len(turned) - NAMED} more" if len(turned) > NAMED else ""
        warnings.append(
            Advisory(
                "distance_accuracy_unavailable",
                "Distance accuracy is not given where the robot turns between the two poses, since the measured point "
                f"then moves otherwise than the commanded one: {', '.join(turned[:NAMED])}{more}.",
                "Command the same orientation at both ends, as the standard's cube does.",
            )
        )
    if not documents and len(poses) > 1:
        warnings.append(
            Advisory(
                "distances_unavailable",
                "Distances are not given: no two poses in one frame, far enough apart, have two numbered cycles in "
                "common.",
                "Tag every image or reading with its cycle, one visit to each pose a cycle.",
            )
        )
    return documents or None


def _assess(
    at: tuple[list[Reading], list[Reading]],
    first_mm: Float[np.ndarray, "3"] | None,
    second_mm: Float[np.ndarray, "3"] | None,
) -> DistanceAssessment | None:
    """Return a distance's figures; None where the poses are the same place."""
    cycles = [_cycles(readings) for readings in at]
    middles = [c.positions_mm.mean(axis=0) for c in cycles]
    spread = max(float(np.max(np.std(c.positions_mm, axis=0))) for c in cycles)
    if float(np.linalg.norm(middles[0] - middles[1])) <= 50.0 * spread:
        return None
    common = [_common(readings) for readings in at]
    return assess_distance(cycles[0], cycles[1], first_mm, second_mm, common[0], common[1])


def _distance_document(
    one: str, other: str, found: DistanceAssessment, places: Sequence[Float[np.ndarray, "3"] | None] | None
) -> dict[str, Any]:
    performance = found.performance
    way = None
    if places is not None and places[0] is not None and places[1] is not None:
        way = float(np.linalg.norm(places[1] - places[0]))
    return {
        "from_pose_id": one,
        "to_pose_id": other,
        "n": performance.cycles,
        "mean_mm": performance.mean_distance_mm,
        "standard_uncertainty_mm": found.standard_uncertainty_mm,
        "commanded_mm": way,
        "accuracy_mm": performance.accuracy_mm,
        "repeatability_mm": performance.repeatability_mm,
        "interval_mm": None if found.interval_mm is None else list(found.interval_mm),
        "noise_floor_mm": found.noise_floor_mm,
    }


def _by_cycle(visits: Sequence[Reading]) -> dict[int, Reading]:
    """Return the visits by cycle; a cycle that visits the pose more than once does not say which visit is meant."""
    times = Counter(visit.cycle for visit in visits)
    return {visit.cycle: visit for visit in visits if visit.cycle is not None and times[visit.cycle] == 1}


def _same_turn(
    one: Commanded | None, other: Commanded | None, at: tuple[list[Reading], list[Reading]]
) -> bool:
    """Tell whether the robot was told one orientation at both ends or, where that is not known, showed no other."""
    told = [_rotation(one), _rotation(other)]
    if told[0] is not None and told[1] is not None:
        return float(np.linalg.norm(so3_log(told[0].T @ told[1]))) <= SAME_TURN
    seen = [readings[0].rotation for readings in at]
    if seen[0] is None or seen[1] is None:
        return True
    return float(np.linalg.norm(so3_log(seen[0].T @ seen[1]))) <= 100.0 * SAME_TURN


def _approaches(
    readings: Mapping[str, list[Reading]], commanded: Mapping[str, Commanded], warnings: list[Advisory]
) -> list[dict[str, Any]] | None:
    """Return vAP of every commanded pose that has two approaches."""
    groups: dict[tuple[Any, ...], dict[str, list[str]]] = {}
    for pose_id in readings:
        told = commanded.get(pose_id)
        key = None if told is None or told.approach is None else _commanded_key(told)
        if told is not None and told.approach is not None and key is not None:
            frame = readings[pose_id][0].frame
            groups.setdefault((frame, *key), {}).setdefault(told.approach, []).append(pose_id)
    documents = []
    for directions in groups.values():
        if len(directions) < 2:
            continue
        found = assess_approaches(
            [_cycles([r for pose_id in poses for r in readings[pose_id]]) for poses in directions.values()]
        )
        documents.append(
            {
                "directions": [
                    {
                        "approach": approach,
                        "pose_ids": poses,
                        "n": sum(len(readings[pose_id]) for pose_id in poses),
                    }
                    for approach, poses in directions.items()
                ],
                "variation": figure_fields(found.figures),
                "noise_floor": figure_fields(found.noise_floor),
            }
        )
    two = [d for d in documents if len(d["directions"]) == 2]
    if two:
        warnings.append(
            Advisory(
                "two_approaches",
                f"{len(two)} of the poses approached from several directions have two of them, which give a lower "
                "bound of the variation over the standard's three.",
                "Approach them from a third direction.",
            )
        )
    if not documents and groups:
        warnings.append(
            Advisory(
                "approach_variation_unavailable",
                "Variation over approaches is not given: no two poses have the same commanded pose and different "
                "approaches.",
                "PUT each direction of approach as a pose of its own, with the same commanded pose and its approach.",
            )
        )
    return documents or None


def _commanded_key(told: Commanded) -> tuple[Any, ...] | None:
    """Return what two poses have in common that were commanded alike; None where nothing is known of it."""
    angles = (told.roll_deg, told.pitch_deg, told.yaw_deg)
    if told.position_mm is not None:
        return (*_rounded(told.position_mm), *(None if a is None else round(a, 6) for a in angles))
    return None if told.joint_angles_deg is None else ("joints", *_rounded(told.joint_angles_deg))


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(value, 6) for value in values]


def _position(told: Commanded | None) -> Float[np.ndarray, "3"] | None:
    if told is None or told.position_mm is None:
        return None
    return np.array(told.position_mm, dtype=np.float64)


def _rotation(told: Commanded | None) -> Float[np.ndarray, "3 3"] | None:
    if told is None or told.roll_deg is None or told.pitch_deg is None or told.yaw_deg is None:
        return None
    return rpy_to_rotation(np.radians([told.roll_deg, told.pitch_deg, told.yaw_deg]))


def _cycles(readings: Sequence[Reading]) -> PoseCycles:
    rotations = [r.rotation for r in readings if r.rotation is not None]
    scatters = [r.scatter for r in readings if r.scatter is not None]
    return PoseCycles(
        np.array([r.position_mm for r in readings]),
        np.array(rotations) if len(rotations) == len(readings) else None,
        np.array(scatters) if len(scatters) == len(readings) else None,
    )


def _common(readings: Sequence[Reading]) -> Float[np.ndarray, "6 k"] | None:
    common = [r.common for r in readings if r.common is not None]
    return np.mean(common, axis=0) if len(common) == len(readings) else None
