"""Goals against the rows of stored runs: holds, short, or not measured."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from benchmarks.goals.goal import Goal, Part
from benchmarks.goals.registry import GOALS
from benchmarks.goals.stored import Section
from benchmarks.table import Row

_FIGURE = re.compile(r"^(-?[\d,]*\.?\d+(?:e-?\d+)?)\s*(.*)$")
ALL_SHOWN = 3
"""Figures of one part that are written out; of more, the smallest and the largest."""


class Verdict(StrEnum):
    HOLDS = "holds"
    SHORT = "SHORT"
    NOT_MEASURED = "not measured"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What stored runs say about one goal."""

    goal: Goal
    measured: str
    verdict: Verdict
    run: str


def judged(sections: Mapping[str, Section], goals: Sequence[Goal] = GOALS) -> list[Outcome]:
    """Return the outcome of every goal."""
    return [judge(goal, sections) for goal in goals]


def judge(goal: Goal, sections: Mapping[str, Section]) -> Outcome:
    """Return the outcome of a goal: short where one figure is, not measured where one is lacking."""
    measured, holds, runs = [], [], []
    for part in goal.parts:
        section = sections.get(part.section)
        rows = [row for row in section.rows if re.fullmatch(part.rows, row.what)] if section else []
        if section is None or not rows:
            measured.append(f"no run of {part.section}" if section is None else "not in the kept run")
            holds.append(None)
            continue
        measured.append(_written(rows))
        holds.append(all(_holds(part, row) for row in rows))
        runs.append(f"{part.section} {section.run}")
    if False in holds:
        verdict = Verdict.SHORT
    else:
        verdict = Verdict.HOLDS if holds and None not in holds else Verdict.NOT_MEASURED
    return Outcome(
        goal, "; ".join(dict.fromkeys(measured)) or "-", verdict, ", ".join(dict.fromkeys(runs)) or "-"
    )


def outcomes_table(outcomes: Iterable[Outcome]) -> str:
    """Return the goals as a Markdown table."""
    lines = ["| what | goal | measured | | run | note |", "|---|---|---|---|---|---|"]
    lines += [
        f"| {o.goal.what} | {o.goal.goal} | {o.measured} | {o.verdict} | {o.run} | {o.goal.note} |"
        for o in outcomes
    ]
    return "\n".join(lines) + "\n"


def _holds(part: Part, row: Row) -> bool:
    if part.own:
        return row.met is True
    value, _ = _parsed(row)
    return part.low <= value <= part.high


def _written(rows: Sequence[Row]) -> str:
    if len(rows) <= ALL_SHOWN:
        return " / ".join(row.measured for row in rows)
    ordered = sorted(rows, key=lambda row: _parsed(row)[0])
    return f"{ordered[0].measured} to {ordered[-1].measured}"


def _parsed(row: Row) -> tuple[float, str]:
    """Return a row's figure and unit; NaN, which meets no limit, where it is not a number."""
    found = _FIGURE.match(row.measured)
    return (float(found[1].replace(",", "")), found[2]) if found else (math.nan, "")
