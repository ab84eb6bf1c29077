"""What is compared of a report: its figures with intervals, and what they were measured under."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from app.records.ids import is_id, moment_of
from app.records.numbers import DH_PARAMETERS
from app.reports.forms import FORMAT, FORMAT_VERSION
from core.errors import listed
from core.geometry import rpy_to_rotation
from core.metrology import same_orientation
from core.numerics import NORMAL_95

Json = Mapping[str, Any]
Key = tuple[str, str]
"""What a figure is of (a pose, a joint, a camera), and its name."""
Orientations = Mapping[str, Float[np.ndarray, "3 3"] | None]
"""By pose."""
_POSE = ("position_mm", "roll_deg", "pitch_deg", "yaw_deg", "joint_angles_deg")
_OF_POSE = "pose "
ALL_POSES = "all poses"
DISTANCE = "distance"
"""Between the mean positions of two poses. It needs no tie of frames, whose uncertainty in AP_p is of the size of the
robot's own deviations: a pose that moved by less shows here.
"""
TURNED_DISTANCE = "distance, robot turned"
"""The same between poses of different orientation: it is the measured point's, which moves where the camera or the
reflector is mounted anew.
"""
DISTANCES = (DISTANCE, TURNED_DISTANCE)
_TEXTS = ("report_id", "kind", "made_at", "measured_at", "source", "poses")
_CONDITIONS = ("load_kg", "speed_percent", "temperature_c")


class NotAReport(Exception):
    """What was read is not the JSON form of a report that this version knows; `is_later` where another version may."""

    def __init__(self, *, is_later: bool = False) -> None:
        super().__init__("a report of a later version" if is_later else "not a report's JSON form")
        self.is_later = is_later


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure with its 95 % interval (None: not known); `is_length` where it is above zero by its nature.

    `deviation` is the value less the data sheet's, where that is stated.
    """

    value: float
    interval: tuple[float, float] | None
    unit: str
    is_length: bool
    deviation: float | None = None


@dataclass(frozen=True, slots=True)
class Summary:
    """What is compared of a report, or of a qualification: figures, and the conditions that make them comparable.

    `session` is its id and name; `poses` is the JSON text of the commanded ones by name, with values in the order of
    `_POSE`: text, since it is the same in most, and reading a thousand of them takes longer than all else.
    """

    report_id: str
    kind: str
    made_at: str
    measured_at: str
    session: tuple[str, str]
    robot_id: str | None
    source: str
    conditions: Mapping[str, float | None]
    poses: str
    figures: Mapping[Key, Figure]
    camera_mount: str = "robot"


def summary_of(content: bytes) -> dict[str, Any]:
    """Return what histories take of a report's JSON form, as plain values to be stored. Raises NotAReport.

    Of poses the geometric mean of a figure: histories compare the same poses alone.
    """
    found = _read(content)
    figures = over_poses(dict(found["figures"]), json.loads(found["poses"]))
    found["figures"] = [[*key, *_row(figure)] for key, figure in figures.items()]
    read_summary(found)
    return found


def read_report(content: bytes) -> Summary:
    """Return what is compared of a report's JSON form, with every pose's figures. Raises NotAReport."""
    found = _read(content)
    return read_summary({**found, "figures": [[*key, *_row(figure)] for key, figure in found["figures"]]})


def over_poses(figures: Mapping[Key, Figure], poses: Iterable[str]) -> dict[Key, Figure]:
    """Return figures without distances, those of poses replaced by their geometric mean, which zeros do not have.

    `poses` are those of the report. A mean that lacks one of them is another figure and says so: where a pose was not
    measured, or visited once, the mean of the others is no change of the robot.
    """
    found: dict[Key, Figure] = {}
    of_poses: dict[str, dict[str, float]] = {}
    for key, figure in figures.items():
        if key[1] in DISTANCES or (figure.is_length and figure.value <= 0.0):
            continue
        if key[0].startswith(_OF_POSE):
            of_poses.setdefault(key[1], {})[key[0].removeprefix(_OF_POSE)] = math.log(figure.value)
        else:
            found[key] = figure
    every = {key[0].removeprefix(_OF_POSE) for key in figures if key[0].startswith(_OF_POSE)} | set(poses)
    for name, logs in of_poses.items():
        mean = float(f"{math.exp(math.fsum(logs.values()) / len(logs)):.10g}")
        missing = sorted(every - logs.keys())
        of = f"{ALL_POSES} but {listed(missing)}" if missing else ALL_POSES
        found[(of, name)] = Figure(mean, None, "mm", True)
    return found


def _read(content: bytes) -> dict[str, Any]:
    try:
        document = json.loads(content)
        if document["format"] != FORMAT:
            raise NotAReport
        if document["format_version"] > FORMAT_VERSION:
            raise NotAReport(is_later=True)
        subject, inputs = document["subject"], document["inputs"]
        robot = inputs["robot"]
        conditions = inputs["session"]["conditions"] or {}
        return {
            "report_id": document["report_id"],
            "kind": document["kind"],
            "made_at": _utc(document["made_at"]),
            "measured_at": _measured_at(document),
            "session": [subject["session"]["id"], subject["session"]["name"]],
            "robot_id": None if robot is None else str(robot["id"]),
            "source": document["source"],
            "camera_mount": inputs["session"].get("camera_mount", "robot"),
            "conditions": {name: _number(conditions.get(name)) for name in _CONDITIONS},
            "poses": json.dumps(
                {pose["pose_id"]: [pose[name] for name in _POSE] for pose in inputs["poses"]}
            ),
            "figures": list(_figures(document["analyses"], inputs["poses"])),
        }
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise NotAReport from error


def read_summary(stored: Any) -> Summary:
    """Return a stored summary as a value. Raises NotAReport for what `summary_of` did not write."""
    try:
        return Summary(
            **{name: _text(stored[name]) for name in _TEXTS},
            session=(_text(stored["session"][0]), _text(stored["session"][1])),
            robot_id=stored["robot_id"],
            camera_mount=_text(stored.get("camera_mount", "robot")),
            conditions={name: _number(stored["conditions"][name]) for name in _CONDITIONS},
            figures={
                (of, name): Figure(
                    float(value),
                    None if low is None else (float(low), float(high)),
                    unit,
                    is_length,
                    deviation,
                )
                for of, name, value, low, high, unit, is_length, deviation in stored["figures"]
            },
        )
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise NotAReport from error


def _row(figure: Figure) -> list[Any]:
    low, high = figure.interval if figure.interval is not None else (None, None)
    return [figure.value, low, high, figure.unit, figure.is_length, figure.deviation]


def _measured_at(document: Json) -> str:
    """Return when a report's first image was taken; else when it or the first reading came.

    Reports of earlier versions do not state that: when they were made.
    """
    taken = document["subject"]["first_captured_at"]
    if taken:
        return _utc(taken)
    inputs = document["inputs"]
    came = [one.get("received_at") for one in inputs.get("images", ())]
    ids = [one["measurement_id"] for one in inputs.get("measured_poses", ())]
    came += [moment_of(one).isoformat() for one in ids if is_id(one)]
    return min((_utc(moment) for moment in came if moment), default=_utc(document["made_at"]))


def _utc(text: str) -> str:
    """Return a time in one form, so that texts are in the order of times."""
    moment = datetime.fromisoformat(text)
    moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    return moment.isoformat().replace("+00:00", "Z")


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _number(value: Any) -> float | None:
    return None if value is None else float(value)


def _figures(analyses: Json, commanded: Iterable[Json]) -> Iterator[tuple[Key, Figure]]:
    repeatability = analyses.get("repeatability", {})
    for pose in repeatability.get("poses", ()):
        yield from _of_pose(pose)
    ordered = {pose["pose_id"]: _rotation(pose) for pose in commanded}
    seen = {pose["pose_id"]: _rotation(pose.get("mean") or {}) for pose in repeatability.get("poses", ())}
    for distance in repeatability.get("distances") or ():
        yield from _of_distance(distance, ordered, seen)
    for group in analyses.get("intrinsics", {}).get("groups", ()):
        of = f"camera {group['focus_group']}"
        for name, value in group["intrinsics"].items():
            yield from _with_uncertainty((of, name), value, group["standard_uncertainty"][name], None)
    for joint in analyses.get("dh", {}).get("joints", ()):
        for name in DH_PARAMETERS:
            if joint[name] is not None and joint["identifiable"][name]:
                yield from _with_uncertainty(
                    (f"joint {joint['joint']}", name),
                    joint[name],
                    joint["standard_uncertainty"][name],
                    (joint.get("nominal") or {}).get(name),
                )


def _of_pose(pose: Json) -> Iterator[tuple[Key, Figure]]:
    of = f"{_OF_POSE}{pose['pose_id']}"
    accuracy = pose["accuracy"] or {"interval": {}}
    for name, value, interval in (
        ("RP_l", pose["repeatability"]["rp_l_mm"], pose["interval"]["rp_l_mm"]),
        ("AP_p", accuracy.get("ap_p_mm"), accuracy["interval"].get("ap_p_mm")),
    ):
        if value is None:
            continue
        # An interval that does not contain its figure, in a report of an earlier version, is not to compare by.
        known = interval is not None and interval[0] <= value <= interval[1]
        yield (of, name), Figure(value, (interval[0], interval[1]) if known else None, "mm", True)
    floor = pose["noise_floor"]["rp_l_mm"]
    if floor is not None:
        yield (of, "noise floor"), Figure(floor, None, "mm", True)


def _rotation(pose: Json) -> Float[np.ndarray, "3 3"] | None:
    angles = [pose.get(name) for name in ("roll_deg", "pitch_deg", "yaw_deg")]
    return None if None in angles else rpy_to_rotation(np.radians(np.array(angles, float)))


def _of_distance(
    distance: Json, commanded: Orientations, measured: Orientations
) -> Iterator[tuple[Key, Figure]]:
    value, u, cycles = distance["mean_mm"], distance["standard_uncertainty_mm"], distance["cycles"]
    if value is not None and u is not None and cycles > 1:
        reach = float(stdtrit(cycles - 1, 0.975)) * u
        first, second = distance["from_pose_id"], distance["to_pose_id"]
        same = same_orientation(
            (commanded.get(first), commanded.get(second)), (measured.get(first), measured.get(second))
        )
        key = f"poses {first} and {second}", DISTANCE if same else TURNED_DISTANCE
        yield key, Figure(value, (value - reach, value + reach), "mm", False)


def _with_uncertainty(
    key: Key, value: float, uncertainty: float | None, nominal: float | None
) -> Iterator[tuple[Key, Figure]]:
    if uncertainty is None or not math.isfinite(uncertainty):
        return
    reach = NORMAL_95 * uncertainty
    deviation = None if nominal is None else value - nominal
    yield key, Figure(value, (value - reach, value + reach), key[1].rpartition("_")[2], False, deviation)
