"""The figures of a report's JSON form, and what they were measured under: what reports are compared by."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from app.cli.console import OptionRefused
from app.reports.forms import FORMAT, FORMAT_VERSION

Json = Mapping[str, Any]
_NORMAL_95 = 1.959964
_PARAMETERS = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg", "beta_deg")
MAX_TEMPERATURE_K = 2.0
"""Difference of temperature up to which sessions count as comparable: links of steel of 1 m expand by 0.024 mm."""
_MAX_POSITION_MM, _MAX_ANGLE_DEG = 0.01, 0.001
"""Differences of a commanded value up to which poses are the same: robots round what is sent to them."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure with its 95 % interval; `is_length` where it is above zero by its nature."""

    value: float
    interval: tuple[float, float]
    unit: str
    is_length: bool


@dataclass(frozen=True, slots=True)
class FiledReport:
    """A report that was read: what it is of, and its figures by what they are of (a pose, a joint) and their names."""

    report_id: str
    kind: str
    made_at: str
    measured_at: str
    session: tuple[str, str]
    document: Json
    figures: Mapping[tuple[str, str], Figure]

    @property
    def robot_id(self) -> str | None:
        """The robot that the session named."""
        robot = self.document["inputs"]["robot"]
        return None if robot is None else str(robot["id"])


def read_filed(content: bytes, name: str) -> FiledReport:
    """Return the report of a JSON form. Raises OptionRefused for what this version does not read as one."""
    try:
        document = json.loads(content)
        if document["format"] != FORMAT or document["format_version"] > FORMAT_VERSION:
            raise OptionRefused(f"{name} is a report of a later version.", "Update gridpose on this machine.")
        subject = document["subject"]
        return FiledReport(
            report_id=document["report_id"],
            kind=document["kind"],
            made_at=document["made_at"],
            measured_at=subject["first_captured_at"] or document["made_at"],
            session=(subject["session"]["id"], subject["session"]["name"]),
            document=document,
            figures=dict(_figures(document["analyses"])),
        )
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise OptionRefused(
            f"{name} is not the JSON form of a report.",
            "Name a report's id, or a file that `gridpose report fetch --form json` saved.",
        ) from error


def unlike(first: FiledReport, second: FiledReport) -> list[str]:
    """Return in what two sessions differ so that their figures are not those of one test."""
    found = []
    if first.kind != second.kind:
        found.append(f"one report is on {first.kind}, the other on {second.kind}")
    if first.robot_id != second.robot_id:
        found.append("they name different robots")
    if first.document["source"] != second.document["source"]:
        found.append("the poses of one are from images, those of the other from another instrument")
    found += _unlike_poses(first.document["inputs"]["poses"], second.document["inputs"]["poses"])
    for name, words, most in _CONDITIONS:
        one, other = _condition(first, name), _condition(second, name)
        if one is not None and other is not None and abs(one - other) > most:
            found.append(f"{words} is {one:g} in one and {other:g} in the other")
    return found


def not_stated(first: FiledReport, second: FiledReport) -> list[str]:
    """Return the conditions that either session does not state, so that nobody knows whether they are the same."""
    return [
        words
        for name, words, _ in _CONDITIONS
        if _condition(first, name) is None or _condition(second, name) is None
    ]


_CONDITIONS = (
    ("load_kg", "the load (kg)", 1e-6),
    ("speed_percent", "the speed (%)", 1e-6),
    ("temperature_c", "the temperature (°C)", MAX_TEMPERATURE_K),
)


def _condition(report: FiledReport, name: str) -> float | None:
    conditions = report.document["inputs"]["session"]["conditions"] or {}
    value = conditions.get(name)
    return None if value is None else float(value)


def _unlike_poses(first: list[Json], second: list[Json]) -> list[str]:
    ours, theirs = ({pose["pose_id"]: pose for pose in poses} for poses in (first, second))
    if set(ours) != set(theirs):
        names = sorted(set(ours) ^ set(theirs))
        return [f"only one has the pose {', '.join(names[:5])}{' ...' if len(names) > 5 else ''}"]
    moved = sorted(name for name, pose in ours.items() if _is_moved(pose, theirs[name]))
    return [f"the commanded pose {', '.join(moved[:5])} is another"] if moved else []


def _is_moved(first: Json, second: Json) -> bool:
    for name, most in (
        ("position_mm", _MAX_POSITION_MM),
        ("joint_angles_deg", _MAX_ANGLE_DEG),
        ("roll_deg", _MAX_ANGLE_DEG),
        ("pitch_deg", _MAX_ANGLE_DEG),
        ("yaw_deg", _MAX_ANGLE_DEG),
    ):
        one, other = first[name], second[name]
        if one is None or other is None:
            continue
        pairs = zip(one, other, strict=True) if isinstance(one, list) else [(one, other)]
        if isinstance(one, list) and len(one) != len(other):
            return True
        if any(abs(a - b) > most for a, b in pairs):
            return True
    return False


def _figures(analyses: Json) -> Iterator[tuple[tuple[str, str], Figure]]:
    for pose in analyses.get("repeatability", {}).get("poses", ()):
        yield from _of_pose(pose)
    for group in analyses.get("intrinsics", {}).get("groups", ()):
        of = f"camera {group['focus_group']}"
        for name, value in group["intrinsics"].items():
            yield from _with_uncertainty(of, name, value, group["standard_uncertainty"][name])
    for joint in analyses.get("dh", {}).get("joints", ()):
        for name in _PARAMETERS:
            if joint[name] is not None and joint["identifiable"][name]:
                yield from _with_uncertainty(
                    f"joint {joint['joint']}", name, joint[name], joint["standard_uncertainty"][name]
                )


def _of_pose(pose: Json) -> Iterator[tuple[tuple[str, str], Figure]]:
    of = f"pose {pose['pose_id']}"
    accuracy = pose["accuracy"] or {"interval": {}}
    for name, value, interval in (
        ("RP_l", pose["repeatability"]["rp_l_mm"], pose["interval"]["rp_l_mm"]),
        ("AP_p", accuracy.get("ap_p_mm"), accuracy["interval"].get("ap_p_mm")),
    ):
        if value is not None and interval is not None and interval[0] <= value <= interval[1]:
            yield (of, name), Figure(value, (interval[0], interval[1]), "mm", True)
    floor = pose["noise_floor"]["rp_l_mm"]
    if floor is not None:
        yield (of, "noise floor"), Figure(floor, (floor, floor), "mm", True)


def _with_uncertainty(
    of: str, name: str, value: float, uncertainty: float | None
) -> Iterator[tuple[tuple[str, str], Figure]]:
    if uncertainty is None or not math.isfinite(uncertainty):
        return
    reach = _NORMAL_95 * uncertainty
    yield (of, name), Figure(value, (value - reach, value + reach), name.rpartition("_")[2], False)
