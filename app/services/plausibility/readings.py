"""Readings of an instrument that are almost surely in another unit: by distances between poses, else by their size."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from app.services.plausibility.stated_values import MAX_ERRORS, MIN_REACH_MM, implausible

MAX_METRES = 100.0
"""No instrument is as far from the robot, m."""
MAX_METRE_SCATTER = 0.002
"""Of readings of one pose: 2 mm in metres, and less than any robot scatters in mm."""
MAX_SCATTER_SHARE = 0.01
"""Of the span of the poses: what scatters more was read about local origins, pose by pose."""
UNIT_FACTOR = 3.3
"""A scale within it of a thousand or a thousandth is one of units, not of a tool's offset."""
MIN_COMMANDED_MM = 0.05
"""Commanded poses that span less are one place."""


def check_readings(
    readings: Sequence[tuple[str, Sequence[float]]], commanded: Mapping[str, Sequence[float]]
) -> None:
    """Raise InvalidContent (`implausible_unit`) for readings of an instrument that look like metres or micrometres.

    By the distances between poses over those commanded, where two poses have both. Otherwise by their size: positions
    that all lie within 100 mm, and poses within 5 mm of one another, are those of no robot. Readings about local
    origins, which scatter visibly against what lies between poses, are not suspected, nor is one pose by itself.

    Parameters
    ----------
    readings
        Pose and position of each; `commanded` are positions by pose.
    """
    visits: dict[str, list[Sequence[float]]] = {}
    for pose_id, position in readings:
        visits.setdefault(pose_id, []).append(position)
    means = {pose_id: _mean(rows) for pose_id, rows in visits.items()}
    squares = [math.dist(row, means[pose_id]) ** 2 for pose_id, rows in visits.items() for row in rows]
    scatter = math.sqrt(sum(squares) / max(len(squares) - len(means), 1))
    near = all(abs(value) < MAX_METRES for _, position in readings for value in position)
    both = [pose_id for pose_id in means if pose_id in commanded]
    of_commands = _span([commanded[pose_id] for pose_id in both])
    span = _span([means[pose_id] for pose_id in (both if of_commands >= MIN_COMMANDED_MM else means)])
    unit, why = None, ""
    if span == 0.0 or scatter > MAX_SCATTER_SHARE * span:
        return
    if of_commands >= MIN_COMMANDED_MM:
        scale = span / of_commands
        unit = "metres" if near and _near(scale, 1e-3) else "micrometres" if _near(scale, 1e3) else None
        why = f"; distances between poses are {scale:.2g} times the commanded ones"
    elif near and len(means) > 1 and span < MIN_REACH_MM and scatter < MAX_METRE_SCATTER:
        unit = "metres"
    if unit is not None:
        factor = 1e3 if unit == "metres" else 1e-3
        fields = [
            (
                f"{place}.position_mm",
                f"{value:g} mm would be {factor * value:g} mm if it was stated in {unit}",
            )
            for place, (_, position) in enumerate(readings[:MAX_ERRORS])
            for value in position
        ]
        raise implausible(unit, fields, why=why)


def _mean(places: Sequence[Sequence[float]]) -> list[float]:
    return [sum(axis) / len(places) for axis in zip(*places, strict=True)]


def _span(places: Sequence[Sequence[float]]) -> float:
    """Return the root mean square distance of places from their mean."""
    if len(places) < 2:
        return 0.0
    middle = _mean(places)
    return math.sqrt(sum(math.dist(place, middle) ** 2 for place in places) / len(places))


def _near(scale: float, unit: float) -> bool:
    return unit / UNIT_FACTOR < scale < unit * UNIT_FACTOR
