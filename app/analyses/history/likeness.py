"""Which reports are comparable: the same robot, source, commanded poses, load, speed and temperature."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from app.analyses.history.summaries import Summary

MAX_TEMPERATURE_K = 2.0
"""Difference of temperature up to which sessions count as comparable: links of steel of 1 m expand by 0.024 mm."""
_MAX_POSITION_MM, _MAX_ANGLE_DEG = 0.01, 0.001
"""Differences of a commanded value up to which poses are the same: robots round what is sent to them."""
_MOST = (_MAX_POSITION_MM, *[_MAX_ANGLE_DEG] * 4)
_CONDITIONS = (
    ("load_kg", "the load (kg)", 1e-6),
    ("speed_percent", "the speed (%)", 1e-6),
    ("temperature_c", "the temperature (°C)", MAX_TEMPERATURE_K),
)
_NAMED = 5


def unlike(first: Summary, second: Summary) -> list[str]:
    """Return in what two sessions differ so that their figures are not those of one test."""
    found = []
    if first.kind != second.kind:
        found.append(f"one report is on {first.kind}, the other on {second.kind}")
    if first.robot_id != second.robot_id:
        found.append("they name different robots")
    if first.source != second.source:
        found.append(
            f"the cameras are {first.source or 'not stated'} and {second.source or 'not stated'}"
            if first.kind == second.kind == "qualification"
            else "the poses of one are from images, those of the other from another instrument"
        )
    if first.camera_mount != second.camera_mount:
        found.append("the camera is on the robot in one and fixed in the other")
    found += _unlike_poses(first.poses, second.poses)
    for name, words, most in _CONDITIONS:
        one, other = first.conditions[name], second.conditions[name]
        if one is not None and other is not None and abs(one - other) > most:
            found.append(f"{words} is {one:g} in one and {other:g} in the other")
    return found


def not_stated(first: Summary, second: Summary) -> list[str]:
    """Return the conditions that either session does not state, so that nobody knows whether they are the same."""
    return [
        words
        for name, words, _ in _CONDITIONS
        if first.conditions[name] is None or second.conditions[name] is None
    ]


def group_comparable(reports: Sequence[Summary], restarts: Sequence[str] = ()) -> list[list[Summary]]:
    """Return reports by tests: those of one test are comparable with its first, and no restart lies between.

    Reports are in time order; `restarts` are the times from which on charts begin anew.
    """
    tests: list[list[Summary]] = []
    groups: dict[tuple[Any, ...], list[list[Summary]]] = {}
    for report in reports:
        epoch = sum(at <= report.measured_at for at in restarts)
        # What `unlike` compares exactly, so that a report is compared with few.
        names = frozenset(poses_in(report.poses))
        likely = groups.setdefault((epoch, report.kind, report.source, names), [])
        test = next((test for test in likely if not unlike(test[0], report)), None)
        if test is None:
            test = []
            likely.append(test)
            tests.append(test)
        test.append(report)
    return tests


@lru_cache(maxsize=256)
def poses_in(text: str) -> Mapping[str, list[Any]]:
    """Return the commanded poses of a summary by name."""
    found: dict[str, list[Any]] = json.loads(text)
    return found


def _unlike_poses(our_text: str, their_text: str) -> list[str]:
    if our_text == their_text:
        return []
    ours, theirs = poses_in(our_text), poses_in(their_text)
    if set(ours) != set(theirs):
        names = sorted(set(ours) ^ set(theirs))
        return [f"only one has the pose {', '.join(names[:_NAMED])}{' ...' if len(names) > _NAMED else ''}"]
    moved = sorted(name for name, pose in ours.items() if _is_moved(pose, theirs[name]))
    return [f"the commanded pose {', '.join(moved[:_NAMED])} is another"] if moved else []


def _is_moved(first: list[Any], second: list[Any]) -> bool:
    for one, other, most in zip(first, second, _MOST, strict=True):
        if one is None or other is None:
            continue
        if not isinstance(one, list):
            one, other = [one], [other]
        if len(one) != len(other) or any(abs(a - b) > most for a, b in zip(one, other, strict=True)):
            return True
    return False
