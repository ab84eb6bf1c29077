"""ISO 9283 distance accuracy and repeatability, and multi-directional variation of pose accuracy.

Both need poses in one frame; distances also need visits numbered by cycle, since a cycle's distance is between the two
poses of that cycle. A length is the same in every frame, but it is the measured point's: it compares with the commanded
one where the same orientation was commanded at both ends, so that all points of the flange move by the same vector.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from operator import is_

import numpy as np
from jaxtyping import Float

from core.errors import Advisory, listed
from core.metrology import (
    ApproachVariation,
    CycleProcess,
    DistanceAssessment,
    PoseCycles,
    assess_approaches,
    assess_distance,
    hides_scatter,
    same_orientation,
)
from core.session.commanded_poses import command_key
from core.session.model import CommandedPose, MeasuredPose
from core.session.repeatability.withheld import (
    MIN_SPREADS_APART,
    Lack,
    distance_of_hidden_scatter,
    distance_pairs_truncated,
    distances_unavailable,
    unscaled_distance,
)
from core.session.visits import cycles_of, mean_common

MAX_PAIRS = 45
"""All pairs of ten poses; of more, all of ten commands, and of more commands each with the next."""


@dataclass(frozen=True, slots=True)
class PoseDistance:
    """The distance between two poses; `commanded_mm` where it compares with what was measured."""

    from_pose_id: str
    to_pose_id: str
    commanded_mm: float | None
    found: DistanceAssessment


@dataclass(frozen=True, slots=True)
class Approaches:
    """One commanded pose approached from several directions: the poses and the number of visits of each."""

    pose_ids: Mapping[str, tuple[str, ...]]
    visits: Mapping[str, int]
    variation: ApproachVariation


@dataclass(frozen=True, slots=True)
class Performance:
    """Both parts, empty where they cannot be given, and the reasons."""

    distances: tuple[PoseDistance, ...]
    approaches: tuple[Approaches, ...]
    warnings: tuple[Advisory, ...]


def assess_performance(
    visits: Mapping[str, Sequence[MeasuredPose]],
    absolute: Mapping[str, Sequence[MeasuredPose]],
    commanded: Mapping[str, CommandedPose],
    *,
    process: CycleProcess | None = None,
    unscaled: frozenset[str] = frozenset(),
    one_camera: bool = True,
) -> Performance:
    """Return distances between poses and variation over approaches, from the visits that count, by pose.

    `absolute` are the same visits as absolute figures take them (`.absolute_poses`): distances do. `process` is what
    their cycles follow, None for independent Gaussian ones. Distances to poses of unknown scale, `unscaled`, have no
    uncertainty. `one_camera` says that all images of a focus group have one.
    """
    warnings: list[Advisory] = []
    distances = [
        replace(one, found=unscaled_distance(one.found))
        if {one.from_pose_id, one.to_pose_id} & unscaled
        else one
        for one in _distances(absolute, commanded, process, warnings, one_camera=one_camera)
    ]
    approaches = _approaches(visits, commanded, warnings)
    return Performance(tuple(distances), tuple(approaches), tuple(warnings))


def _distances(
    readings: Mapping[str, Sequence[MeasuredPose]],
    commanded: Mapping[str, CommandedPose],
    process: CycleProcess | None,
    warnings: list[Advisory],
    *,
    one_camera: bool,
) -> list[PoseDistance]:
    poses = list(readings)
    if math.comb(len(poses), 2) > MAX_PAIRS:
        poses = _one_of_each_command(readings, commanded)
    truncated = math.comb(len(poses), 2) > MAX_PAIRS
    pairs = list(pairwise(poses))[:MAX_PAIRS] if truncated else list(combinations(poses, 2))
    numbered = {pose_id: _by_cycle(visits) for pose_id, visits in readings.items()}
    cycles = {pose_id: cycles_of(visits) for pose_id, visits in readings.items()}
    distances: list[PoseDistance] = []
    turned: list[str] = []
    lacks: dict[Lack, list[str]] = {}
    for one, other in pairs:
        first, second = numbered[one], numbered[other]
        shared = [c for c in first if c in second]
        lack = _lack(readings[one], readings[other], shared)
        if lack is not None:
            lacks.setdefault(lack, []).append(f"{one}-{other}")
            continue
        at = [first[c] for c in shared], [second[c] for c in shared]
        ordered = [None if pose is None else pose.rotation() for pose in map(commanded.get, (one, other))]
        same = same_orientation((ordered[0], ordered[1]), (at[0][0].rotation, at[1][0].rotation))
        places = [_position(commanded.get(pose_id)) for pose_id in (one, other)]
        comparable = all(place is not None for place in places) and same
        ends = (places[0], places[1]) if comparable else (None, None)
        # Most pairs share all visits of their poses, whose cycles are then checked once for all pairs.
        of_ends = [
            cycles[pose_id] if _are_same(visits, readings[pose_id]) else cycles_of(visits)
            for pose_id, visits in zip((one, other), at, strict=True)
        ]
        found = _assess(at, of_ends, *ends, process)
        if found is None:
            lacks.setdefault(Lack.LENGTH, []).append(f"{one}-{other}")
            continue
        if all(place is not None for place in places) and not same:
            turned.append(f"{one}-{other}")
        way = None
        if comparable and places[0] is not None and places[1] is not None:
            way = float(np.linalg.norm(places[1] - places[0]))
        distances.append(PoseDistance(one, other, way, found))
    if turned:
        warnings.append(
            Advisory(
                "distance_accuracy_unavailable",
                "Distance accuracy is not given where the robot turns between the two poses, since the measured point "
                f"then moves otherwise than the commanded one: {listed(turned)}.",
                "Command the same orientation at both ends, as the standard's cube does.",
            )
        )
    if distances and truncated:
        warnings.append(distance_pairs_truncated(len(poses), len(pairs), len(distances), MAX_PAIRS, lacks))
    if not distances and len(poses) > 1:
        warnings.append(distances_unavailable(lacks, one_camera=one_camera))
    return distances


def _one_of_each_command(
    readings: Mapping[str, Sequence[MeasuredPose]], commanded: Mapping[str, CommandedPose]
) -> list[str]:
    """Return the first pose of each command, as of several approaches, and those of unknown command."""
    found: dict[Hashable, str] = {}
    for pose_id, visits in readings.items():
        key = command_key(commanded[pose_id]) if pose_id in commanded else None
        found.setdefault(pose_id if key is None else (visits[0].frame, key), pose_id)
    return list(found.values())


def _lack(
    first: Sequence[MeasuredPose], second: Sequence[MeasuredPose], shared: Sequence[int]
) -> Lack | None:
    """Return what two poses lack for a distance, apart from its length; None where they have it."""
    if min(len(first), len(second)) < 2:
        return Lack.VISITS
    if first[0].frame != second[0].frame:
        return Lack.FRAME
    if len(shared) >= 2:
        return None
    numbers = [{visit.cycle for visit in visits} - {None} for visits in (first, second)]
    return Lack.REPEATED if len(numbers[0] & numbers[1]) >= 2 else Lack.CYCLES


def _are_same(visits: Sequence[MeasuredPose], others: Sequence[MeasuredPose]) -> bool:
    return len(visits) == len(others) and all(map(is_, visits, others))


def _assess(
    at: tuple[Sequence[MeasuredPose], Sequence[MeasuredPose]],
    cycles: Sequence[PoseCycles],
    first_mm: Float[np.ndarray, "3"] | None,
    second_mm: Float[np.ndarray, "3"] | None,
    process: CycleProcess | None,
) -> DistanceAssessment | None:
    """Return a distance's figures; None where the poses are the same place."""
    middles = [c.positions_mm.mean(axis=0) for c in cycles]
    spread = max(float(np.max(np.std(c.positions_mm, axis=0))) for c in cycles)
    if float(np.linalg.norm(middles[0] - middles[1])) <= MIN_SPREADS_APART * spread:
        return None
    common = [mean_common(readings) for readings in at]
    found = assess_distance(cycles[0], cycles[1], first_mm, second_mm, common[0], common[1], process)
    hidden = any(hides_scatter(c.positions_mm) for c in cycles)
    return distance_of_hidden_scatter(found) if hidden else found


def _by_cycle(visits: Sequence[MeasuredPose]) -> dict[int, MeasuredPose]:
    """Return the visits by cycle, without cycles that visit the pose more than once."""
    times = Counter(visit.cycle for visit in visits)
    return {visit.cycle: visit for visit in visits if visit.cycle is not None and times[visit.cycle] == 1}


def _approaches(
    readings: Mapping[str, Sequence[MeasuredPose]],
    commanded: Mapping[str, CommandedPose],
    warnings: list[Advisory],
) -> list[Approaches]:
    """Return vAP of every commanded pose that has two approaches."""
    groups: dict[tuple[Hashable, ...], dict[str, list[str]]] = {}
    for pose_id in readings:
        pose = commanded.get(pose_id)
        key = None if pose is None or pose.approach is None else command_key(pose)
        if pose is not None and pose.approach is not None and key is not None:
            frame = readings[pose_id][0].frame
            groups.setdefault((frame, key), {}).setdefault(pose.approach, []).append(pose_id)
    found = []
    for directions in groups.values():
        if len(directions) < 2:
            continue
        variation = assess_approaches(
            [cycles_of([r for pose_id in poses for r in readings[pose_id]]) for poses in directions.values()]
        )
        found.append(
            Approaches(
                {approach: tuple(poses) for approach, poses in directions.items()},
                {approach: sum(len(readings[p]) for p in poses) for approach, poses in directions.items()},
                variation,
            )
        )
    two = [one for one in found if len(one.pose_ids) == 2]
    if two:
        warnings.append(
            Advisory(
                "approach_variation_from_two_directions",
                f"{len(two)} of the poses approached from several directions have two of them, which give a lower "
                "bound of the variation over the standard's three.",
                "Approach them from a third direction.",
            )
        )
    if not found and groups:
        warnings.append(
            Advisory(
                "approach_variation_unavailable",
                "Variation over approaches is not given: no two poses have the same commanded pose and different "
                "approaches.",
                "PUT each direction of approach as a pose of its own, with the same commanded pose and its approach.",
            )
        )
    return found


def _position(pose: CommandedPose | None) -> Float[np.ndarray, "3"] | None:
    if pose is None or pose.position_mm is None:
        return None
    return np.array(pose.position_mm, dtype=np.float64)
