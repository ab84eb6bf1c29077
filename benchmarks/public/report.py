"""The table of a run, and all its figures as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np

from benchmarks.public.scoring import Score, found_fraction, ratio_on_common, rms_px
from benchmarks.public.suite import FACTORS

OURS = "gridpose"
Scores = Mapping[tuple[str, str], Sequence[Score]]
"""By target and detector, in the order of the suite's images."""


def table(scores: Scores) -> str:
    """Return one Markdown table: a row for each target and detector, a column for each factor.

    A cell has the rms error of one coordinate over the points found, px, and the share of points found where that is
    less than all.
    """
    factors = [f for f in FACTORS if any(s.item.condition.factor == f for of in scores.values() for s in of)]
    heads = ["target", "detector", *factors, "wrong points", "error ÷ ours", "time", "time ÷ ours"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for (target, name), of in scores.items():
        ours = scores.get((target, OURS))
        cells = [target, name]
        cells += [_cell([s for s in of if s.item.condition.factor == factor]) for factor in factors]
        cells.append(f"{sum(s.wrong for s in of):,}")
        theirs = name != OURS and ours is not None
        cells.append(_number(ratio_on_common(of, ours)) if theirs and ours is not None else "")
        cells.append(f"{1e3 * _median_seconds(of):.1f} ms")
        cells.append(
            _number(_median_seconds(of) / _median_seconds(ours)) if theirs and ours is not None else ""
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def exceptions(scores: Scores) -> str:
    """Return a Markdown list of every level of every factor in which another detector was more accurate on the same
    points, or found more of them; empty without any."""
    lines = []
    for (target, name), of in scores.items():
        ours = scores.get((target, OURS))
        if name == OURS or ours is None:
            continue
        for condition in dict.fromkeys(s.item.condition for s in of):
            at = [k for k, s in enumerate(of) if s.item.condition == condition]
            theirs_here, ours_here = [of[k] for k in at], [ours[k] for k in at]
            ratio = ratio_on_common(theirs_here, ours_here)
            found = found_fraction(theirs_here), found_fraction(ours_here)
            where = f"{target}, {condition.factor} {condition.level}".rstrip()
            if ratio < 1.0:
                lines.append(f"- {where}: {name} has {ratio:.2f} of our error on the same points.")
            if found[0] > found[1] + 1e-3:
                lines.append(
                    f"- {where}: {name} finds {100 * found[0]:.0f} % of its points, ours {100 * found[1]:.0f} %."
                )
    return "\n".join(lines) + "\n" if lines else ""


def document(scores: Scores) -> list[dict[str, Any]]:
    """Return a JSON-ready row for each target, detector, factor and level; a figure there is not is null."""
    rows = []
    for (target, name), of in scores.items():
        for condition in dict.fromkeys(s.item.condition for s in of):
            here = [s for s in of if s.item.condition == condition]
            rms = rms_px(here)
            rows.append(
                {
                    "target": target,
                    "detector": name,
                    "factor": condition.factor,
                    "level": condition.level,
                    "images": len(here),
                    "points_in_view": sum(s.asked for s in here),
                    "points_found": sum(len(s.labels) for s in here),
                    "points_wrong": sum(s.wrong for s in here),
                    "rms_px": rms if math.isfinite(rms) else None,
                    "median_ms": 1e3 * _median_seconds(here),
                }
            )
    return rows


def _cell(scores: Sequence[Score]) -> str:
    share = found_fraction(scores)
    if not np.isfinite(share) or share == 0.0:
        return "not found"
    text = f"{rms_px(scores):.4f}"
    return text if share > 0.999 else f"{text} ({100.0 * share:.0f} %)"


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "-"


def _median_seconds(scores: Sequence[Score]) -> float:
    return median(s.seconds for s in scores)
