"""Under what conditions the standard's test poses are visited: loads, speeds, warm-up, and directions of approach."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from core.errors import InvalidArgument

Json = dict[str, Any]
APPROACHED = ("P1", "P2", "P4")
"""Poses that are approached from several directions (ISO 9283:1998, 7.2.3)."""
DIRECTIONS = {
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
}
"""From where a pose is approached, in the base frame, in the order in which they are taken."""
MAX_RUNS = 12


class PlanRefused(InvalidArgument):
    """What is asked for is no test that can be run."""


def runs(loads_kg: Sequence[float], speeds_percent: Sequence[float]) -> list[Json]:
    """Return the runs of a test: every load at every speed; one run of neither where none is stated.

    Raises PlanRefused for values that no robot has, and for more runs than a check list holds.
    """
    if not all(math.isfinite(load) and load >= 0.0 for load in loads_kg):
        raise PlanRefused("A load is 0 kg or more.")
    if not all(0.0 < speed <= 100.0 for speed in speeds_percent):
        raise PlanRefused("A speed is more than 0 and at most 100 per cent of the rated one.")
    found = [
        {"run": number, "load_kg": load, "speed_percent": speed}
        for number, (load, speed) in enumerate(
            itertools.product(loads_kg or (None,), speeds_percent or (None,)), start=1
        )
    ]
    if len(found) > MAX_RUNS:
        raise PlanRefused(f"{len(found)} runs are planned, more than {MAX_RUNS}.", "Make several plans.")
    return found


def approach_poses(poses: Sequence[Json], directions: int, distance_mm: float) -> list[Json]:
    """Return P1, P2 and P4 once for each direction of approach, as poses of their own, with where the last way begins.

    Raises PlanRefused for a distance of 0 mm or less.
    """
    if directions < 2:
        return []
    if not (math.isfinite(distance_mm) and distance_mm > 0.0):
        raise PlanRefused("The approach must be longer than 0 mm.")
    found = []
    for pose in poses:
        if pose["pose_id"] not in APPROACHED:
            continue
        for name, way in itertools.islice(DIRECTIONS.items(), directions):
            found.append(
                {
                    **pose,
                    "pose_id": f"{pose['pose_id']}_from_{name.replace('-', 'minus_')}",
                    "approach": name,
                    "approach_from_mm": _from(pose["position_mm"], way, distance_mm),
                }
            )
    return found


def _from(position_mm: Sequence[float], way: Sequence[float], distance_mm: float) -> list[float]:
    begin: Float[np.ndarray, "3"] = np.add(position_mm, distance_mm * np.array(way))
    return [float(value) for value in begin.round(6) + 0.0]


def sentences(plan: dict[str, Any]) -> list[str]:
    """Return what the conditions ask for, a sentence each."""
    found = []
    if plan["warm_up_min"] is not None:
        found.append(f"Warm-up of {plan['warm_up_min']:g} min before the first cycle.")
    stated = [one for one in plan["runs"] if one["load_kg"] is not None or one["speed_percent"] is not None]
    if stated:
        found.append(f"{len(stated)} runs, a session each: {'; '.join(map(run_text, stated))}.")
    if plan["approach_poses"]:
        ways = ", ".join(dict.fromkeys(pose["approach"] for pose in plan["approach_poses"]))
        found.append(f"{', '.join(APPROACHED)} are approached from {ways} in every cycle as well.")
    views = ", ".join(pose["pose_id"] for pose in plan["additional_poses"])
    found.append(
        f"{views} are taken once, for the lens. Send them without a cycle number (gridpose upload --cycles none): with "
        "one they are poses of the test that lack cycles, and no robot passes."
    )
    return found


def run_text(run: Json) -> str:
    parts = []
    if run["load_kg"] is not None:
        parts.append(f"{run['load_kg']:g} kg")
    if run["speed_percent"] is not None:
        parts.append(f"{run['speed_percent']:g} %")
    return f"run {run['run']}: {' at '.join(parts)}"
