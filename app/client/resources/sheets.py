"""Ids of printed sheets (`gp-5d49aa3e`), by which `--target sheet:ID` finds a target of the service.

A sheet's id is a hash of its pattern. It is computed here of what the service has, without drawing; the program that
prints has it of the drawn pattern itself, and a test compares both.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Iterator
from typing import Any

from ..http import ArgumentRefused

_SHEET = re.compile(r"(?:gp-)?(?P<digits>[0-9a-f]{8})", re.IGNORECASE)
_PREFIX = "sheet:"
_DOTS = ("circles", "asymmetric_circles")
_ORIGIN_DOTS = tuple(number / 100 for number in range(101, 241))
"""Widths of the dot at the origin that are looked for, relative to the others: to two decimals."""
_DICTIONARY = re.compile(r"(?P<family>DICT_[4-7]X[4-7]_)(?P<markers>50|100|250|1000)")
_SIZES = (50, 100, 250, 1000)


def sheet_matcher(text: str) -> Callable[[dict[str, Any]], bool] | None:
    """Return what determines whether a target of the service is printed on the sheet `sheet:ID`; None for another text.

    Raises ArgumentRefused `target_not_described` for a text that begins like one and has no id.
    """
    if not text.startswith(_PREFIX):
        return None
    match = _SHEET.fullmatch(text.removeprefix(_PREFIX).strip())
    if match is None:
        raise ArgumentRefused(
            "target_not_described",
            f"--target {text} cannot be read: a sheet's id is gp- and eight digits or letters a to f.",
            "Write it as the sheet prints it before the target's description, e.g. sheet:gp-5d49aa3e.",
        )
    sheet_id = f"gp-{match['digits'].lower()}"
    return lambda target: sheet_id in _sheet_ids(target)


def _sheet_ids(target: dict[str, Any]) -> Iterator[str]:
    """Yield the ids of all sheets that a target may be printed on: plain, with marks, with a dot at the origin."""
    fields = _as_printed(target)
    extras: list[dict[str, Any]] = [{}]
    if target["kind"] == "chessboard":
        extras.append({"marks": True})
    elif target["kind"] in _DOTS:
        extras += ({"origin_dot": ratio} for ratio in _ORIGIN_DOTS)
    for extra in extras:
        # What a target lacks is left away, so that a new field does not change the ids of earlier sheets.
        described = {key: value for key, value in sorted((fields | extra).items()) if value}
        yield f"gp-{hashlib.sha256(json.dumps(described).encode()).hexdigest()[:8]}"


def _as_printed(target: dict[str, Any]) -> dict[str, Any]:
    """Return the shortest description of the print: without fields equal to their defaults."""
    kind, columns, rows, marker_mm = (target[name] for name in ("kind", "columns", "rows", "marker_mm"))
    pitch_mm, dictionary, legacy_layout = (
        float(target["pitch_mm"]),
        target["dictionary"],
        target["legacy_layout"],
    )
    if kind in _DOTS:
        apart = pitch_mm * (math.sqrt(2.0) if kind == "asymmetric_circles" else 1.0)
        marker_mm = None if marker_mm == 0.5 * apart else marker_mm
    elif kind == "aprilgrid":
        dictionary = None
    elif kind == "charuco":
        legacy_layout = (
            legacy_layout and rows % 2 == 1
        )  # with an odd number of rows of squares both are the same
        dictionary = _least_dictionary(dictionary, markers=(columns + 1) * (rows + 1) // 2)
    return {
        "kind": kind,
        "columns": columns,
        "rows": rows,
        "pitch_mm": pitch_mm,
        "marker_mm": None if marker_mm is None else float(marker_mm),
        "dictionary": dictionary,
        "legacy_layout": legacy_layout,
    }


def _least_dictionary(name: str, markers: int) -> str:
    """Return the smallest of OpenCV's dictionaries that begins with the same markers, by its first name."""
    match = _DICTIONARY.fullmatch(name)
    if match is None:
        return re.sub(r"(?<=[0-9])h(?=[0-9])", "H", name)  # those of AprilTag and MIP have two names
    size = next((size for size in _SIZES if size >= markers), int(match["markers"]))
    return f"{match['family']}{size}"
