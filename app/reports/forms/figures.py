"""Every figure of a document by its name, and all of them as a CSV table.

A name is the way through the document: keys joined by dots, an entry of a list by what identifies it, else by its
number from 1: `repeatability.poses[P1].repeatability.rp_l_mm`.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping
from typing import Any

from app.markup import guarded
from app.reports.forms.wording import reading_id

Figure = str | float | int | bool | None
_IDENTITIES = (
    *("pose_id", "joint", "name", "measurement_id", "measured_pose_id"),
    *("figure", "target_id", "source", "code"),
)
_UNIT = re.compile(r"(?:_|\.(?=rad_per_m))(mm_per_h|rad_per_m|mm|deg|px|mrad|rad|s|h|kg|percent|min|c)$")
_UNITS = {
    "deg": "degree",
    "percent": "%",
    "c": "degree Celsius",
    "mm_per_h": "mm/h",
    "rad_per_m": "rad/m",
}


def figures_of(document: Mapping[str, Any], prefix: str = "") -> dict[str, Figure]:
    """Return every value of a document that is no object and no list, by its name."""
    return dict(_walk(document, prefix))


def figures_csv(document: Mapping[str, Any]) -> bytes:
    """Return the figures of a report's analyses as CSV (RFC 4180, UTF-8): analysis, figure, value, unit.

    What does not count is named by its pose and cycle as well.
    """
    known = {
        one["measurement_id"]: one
        for name in ("images", "measured_poses")
        for one in document["inputs"][name]
    }
    text = io.StringIO()
    rows = csv.writer(text)
    rows.writerow(("analysis", "figure", "value", "unit"))
    for analysis, found in document["analyses"].items():
        for name, value in figures_of(found).items():
            rows.writerow((analysis, guarded(name), _cell(value), unit_of(name)))
        for one in found.get("excluded", ()):
            name_of = reading_id(one)
            source = known.get(name_of, {})
            for name in ("pose_id", "cycle"):
                rows.writerow((analysis, f"excluded[{name_of}].{name}", _cell(source.get(name)), ""))
    return text.getvalue().encode()


def unit_of(name: str) -> str:
    """Return the unit that a figure's name ends with; empty without one."""
    found = _UNIT.search(re.sub(r"\[[^\]]*\]$", "", name))
    return _UNITS.get(found[1], found[1]) if found else ""


def _walk(value: Any, name: str) -> Iterator[tuple[str, Figure]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _walk(item, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list):
        taken: set[str] = set()
        for place, item in enumerate(value, start=1):
            label = _label(item, place)
            if label in taken:
                label = f"{label}#{place}"
            taken.add(label)
            yield from _walk(item, f"{name}[{label}]")
    else:
        yield name, value


def _label(item: Any, place: int) -> str:
    if isinstance(item, Mapping):
        for key in _IDENTITIES:
            if isinstance(item.get(key), str | int):
                return str(item[key])
        if "from_pose_id" in item:
            return f"{item['from_pose_id']} to {item['to_pose_id']}"
    return str(place)


def _cell(value: Figure) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return guarded(value) if isinstance(value, str) else repr(value)
