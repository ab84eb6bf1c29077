"""The joints of a robot from a CSV or from a URDF."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ... import Json
from ...pose_rows import number_of
from ..record_files import FileRefused, Record, Records, read_records, refuse_mixed_signs
from ..rotations import frame_words
from .urdf import read_urdf

NEEDED = ("a_mm", "alpha_deg", "d_mm")
OPTIONAL = ("theta_offset_deg", "beta_deg", "minimum_deg", "maximum_deg", "name")
_IGNORED = ("joint", "parallel_to_next")
_IGNORED_PREFIXES = ("u_", "nominal_", "identifiable_")
_MAX_UNSTATED_MM = 0.01


def read_joints(path: Path, say: Callable[[str], None]) -> list[Json]:
    """Return the joints that a file describes, from the base on; what else is worth knowing of it is said.

    A CSV has a row per joint with the columns of `NEEDED` and, where known, of `OPTIONAL`; the CSV of
    `gridpose robots export` is one. Any other file is taken as URDF. Raises FileRefused.
    """
    if path.suffix.lower() in (".csv", ".tsv", ".txt"):
        return _of_table(read_records(path, "csv", None))
    robot = read_urdf(path)
    say(f"{len(robot.joints)} joints to link {robot.end} of {robot.name}")
    if robot.deviation_mm > _MAX_UNSTATED_MM:
        say(
            f"Warning: the parameters differ from the URDF by up to {robot.deviation_mm:.2g} mm: it rounds angles, or "
            "its axes are not exactly parallel."
        )
    turned = [str(place) for place, joint in enumerate(robot.joints, 1) if "beta_deg" in joint]
    if turned:
        say(
            f"Joint{'s' if len(turned) > 1 else ''} {', '.join(turned)}: nearly parallel to the next, with beta_deg in "
            "place of d_mm; lengths along parallel axes are in d_mm of the last of these joints."
        )
    frames = [("--base", robot.T_base_dh.inverse()), ("--tool", robot.T_last_end)]
    given = [f"{option} {words}" for option, frame in frames if (words := frame_words(frame)) is not None]
    if given:
        say(programs_hint(f"{robot.end} in {robot.base}", " ".join(given)))
    return robot.joints


def programs_hint(stated: str, options: str) -> str:
    """Return how to correct Cartesian points that a controller states in another base, or of another flange."""
    return (
        "Poses of this robot are those of its last frame in frame 0 of its parameters. For Cartesian points of "
        f"{stated}, give `robots compensate` {options}, before the frames of the program."
    )


def _of_table(records: Records) -> list[Json]:
    if not records.entries:
        raise FileRefused(
            "The file holds no joints.", f"Write a row per joint under {', '.join(NEEDED)}, ..."
        )
    refuse_mixed_signs(records, [name for name in (*NEEDED, *OPTIONAL) if name != "name"])
    return [_joint(record, records.delimiter) for record in records.entries]


def _joint(record: Record, delimiter: str | None) -> Json:
    joint: Json = {}
    for name, cell in record.fields.items():
        if name in _IGNORED or name.startswith(_IGNORED_PREFIXES) or not cell:
            continue
        if name not in (*NEEDED, *OPTIONAL):
            raise FileRefused(
                f"The file has a column {name}, which no joint has.",
                f"Columns are {', '.join((*NEEDED, *OPTIONAL))}.",
            )
        joint[name] = cell if name == "name" else _number(record, name, cell, delimiter)
    absent = [name for name in NEEDED if name not in joint]
    if absent:
        raise FileRefused(
            f"In {record.place} the joint has no {', '.join(absent)}.", "Fill it; 0 is a value."
        )
    return joint


def _number(record: Record, name: str, cell: Any, delimiter: str | None) -> float:
    text = str(cell)
    value = number_of(text, comma=delimiter != ",")
    if not math.isfinite(value):
        raise FileRefused(f"In {record.place} {name} is not a number: {text[:40]}.")
    return value
