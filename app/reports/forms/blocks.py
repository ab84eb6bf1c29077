"""Blocks of a report, which every form draws in its own way, and how numbers are written in them.

A number with an interval or a standard uncertainty is written to the second significant digit of the uncertainty
(GUM 7.2.6); a quarter of the interval's width stands for it. What is not known is a dash.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from app.reports.forms.wording import reading_id, words

Block = dict[str, Any]
UNKNOWN = "–"
MAX_PLACES = 7
MAX_ROUNDED = 0.05
"""Of a number, by which rounding may change it at most."""
MAX_MORE = 4
"""Places more than usual, in which a figure and an end of its interval may differ."""
LEADING = {"too_few_cycles": "No repeatability is stated", "cycles_not_stated": "Cycles are not stated"}
"""Warnings without which no figure is to be read, and the headings under which a report begins with them."""
NORMAL_95 = 1.959964
"""Coverage factor of a normal figure's 95 % interval."""


def heading(text: str) -> Block:
    """Return a section's heading."""
    return {"block": "heading", "text": text}


def paragraph(text: str) -> Block:
    """Return a paragraph."""
    return {"block": "paragraph", "text": text}


def notes(texts: Sequence[str]) -> list[Block]:
    """Return a list of notes; no block without any."""
    return [{"block": "notes", "items": list(texts)}] if texts else []


def facts(rows: Sequence[tuple[str, Any]]) -> Block:
    """Return labels with their values; a value that is None is written as not stated."""
    return {"block": "facts", "rows": [[label, _stated(value)] for label, value in rows]}


def table(
    caption: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    text_columns: int = 1,
    wide: int | None = None,
) -> list[Block]:
    """Return a table whose first `text_columns` columns are aligned left, the others right; no block without rows.

    The column `wide`, from 0, takes the width that the others leave: that of sentences.
    """
    if not rows:
        return []
    aligned = ["left" if place < text_columns else "right" for place in range(len(columns))]
    return [
        {
            "block": "table",
            "caption": caption,
            "columns": list(columns),
            "align": aligned,
            "wide": wide,
            "rows": [[str(cell) for cell in row] for row in rows],
        }
    ]


def drawing(svg: str, caption: str, alternative: str) -> Block:
    """Return a drawing; `alternative` says in words what it shows."""
    return {"block": "drawing", "svg": svg, "caption": caption, "alternative": alternative}


def number(value: float | None, uncertainty: float | None = None, *, places: int = 4) -> str:
    """Return a number to the second digit of its uncertainty; with `places` decimal places without one."""
    if value is None:
        return UNKNOWN
    if uncertainty is not None and uncertainty > 0.0 and math.isfinite(uncertainty):
        places = _places(uncertainty)
    text = f"{value:.{places}f}"
    if text.startswith("-") and not text.strip("-0."):
        text = text[1:]  # no minus zero
    return text.replace("-", "−")


def with_interval(value: float | None, interval: Sequence[float] | None) -> tuple[str, str]:
    """Return a number and its interval, both to the second digit of a quarter of the interval's width.

    That is about the standard uncertainty. Wherever a report states a figure, its interval decides its digits. Of a
    skewed interval an end far below the others has two digits of its own, and what differs is written differently.
    """
    if interval is None:
        return number(value), UNKNOWN
    quarter = 0.25 * (interval[1] - interval[0])
    if not (quarter > 0.0 and math.isfinite(quarter)):
        low, high = (number(end) for end in interval)
        return number(value), f"{low} … {high}"
    usual = _places(quarter)
    ends = [_own_places(end, usual) for end in interval]
    if value is None:
        own = usual
    else:
        own = _own_places(value, usual) if interval[0] >= 0.0 else usual
        for k, end in enumerate(interval):
            at = max(own, ends[k])
            more = next((p for p in range(at, usual + MAX_MORE) if f"{value:.{p}f}" != f"{end:.{p}f}"), at)
            if more > at:
                own = ends[k] = more
    low, high = (number(end, places=at) for end, at in zip(interval, ends, strict=True))
    return number(value, places=own), f"{low} … {high}"


def _places(uncertainty: float) -> int:
    """Return the decimal places to the second digit of an uncertainty."""
    return min(max(1 - math.floor(math.log10(uncertainty)), 0), MAX_PLACES)


def _own_places(value: float, places: int) -> int:
    """Return so many places; those of two digits of the value where they would leave less of it."""
    is_spoilt = abs(round(value, places) - value) > MAX_ROUNDED * abs(value)
    return max(_places(abs(value)), places) if is_spoilt else places


def of_its_own_size(value: float | None) -> str:
    """Return a figure with two digits of its own: a floor, which may be far below the others."""
    return number(value, value)


def of_unknown_uncertainty(value: float | None) -> str:
    """Return a figure that has no interval: as if it were known to a tenth, which is more than is known of it."""
    return number(value, None if value is None else 0.1 * abs(value))


def vector(values: Sequence[float] | None) -> list[str]:
    """Return three numbers as cells."""
    return [UNKNOWN] * 3 if values is None else [number(value, places=3) for value in values]


def warnings_of(document: Mapping[str, Any]) -> list[Block]:
    """Return an analysis's warnings as notes, with their advice; those that a report begins with stand there alone."""
    texts = [_with_advice(one) for one in document["warnings"] if one["code"] not in LEADING]
    return [heading("Warnings"), *notes(texts)] if texts else []


def leading_notes(document: Mapping[str, Any]) -> list[Block]:
    """Return what must be read before any figure of an analysis, under a heading of its own; none in most."""
    found = [one for one in document["warnings"] if one["code"] in LEADING]
    return [block for one in found for block in (heading(LEADING[one["code"]]), paragraph(_with_advice(one)))]


def excluded_of(
    document: Mapping[str, Any], inputs: Mapping[str, Any], title: str = "Excluded measurements"
) -> list[Block]:
    """Return what does not count in an analysis, each with pose, cycle and reason."""
    known = {one["measurement_id"]: one for one in (*inputs["images"], *inputs["measured_poses"])}
    rows = []
    for one in document["excluded"]:
        source = known.get(reading_id(one), {})
        cycle = source.get("cycle")
        rows.append(
            [
                str(source.get("pose_id", UNKNOWN)),
                UNKNOWN if cycle is None else str(cycle),
                one["filename"] or UNKNOWN,
                words(one["code"]),
                one["detail"],
            ]
        )
    if not rows:
        return [heading(title), paragraph("None: every measurement counts.")]
    columns = ("pose", "cycle", "image", "reason", "detail")
    return [
        heading(title),
        *table("Measurements that do not count, each with its reason", columns, rows, text_columns=5, wide=4),
    ]


def _with_advice(warning: Mapping[str, Any]) -> str:
    return " ".join(part for part in (warning["detail"], warning["advice"]) if part)


def _stated(value: Any) -> str:
    if value is None or value == "":
        return "not stated"
    return str(value)
