"""One measured figure and its goal, and the tables they are printed in.

A benchmark module exposes

    def rows(seeds: list[int], quick: bool) -> Iterable[Row]

and is found by its presence in this package. `seeds` are the scenes' seeds (never tune to one), `quick` asks
for a run of seconds whose figures are only indicative. Yield each row as soon as it is measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Row:
    """A figure: what was measured, the reading, the goal and whether it is met (None: it has no goal)."""

    what: str
    measured: str
    goal: str = "-"
    met: bool | None = None
    note: str = ""

    @classmethod
    def at_most(cls, what: str, value: float, limit: float, unit: str = "", note: str = "") -> Row:
        """Return a row whose goal is an upper limit; NaN never meets it."""
        return cls(what, figure(value, unit), f"≤ {figure(limit, unit)}", bool(value <= limit), note)

    @classmethod
    def at_least(cls, what: str, value: float, limit: float, unit: str = "", note: str = "") -> Row:
        """Return a row whose goal is a lower limit; NaN never meets it."""
        return cls(what, figure(value, unit), f"≥ {figure(limit, unit)}", bool(value >= limit), note)

    @classmethod
    def within(cls, what: str, value: float, low: float, high: float, unit: str = "", note: str = "") -> Row:
        """Return a row whose goal is an interval."""
        goal = f"{figure(low, unit)} to {figure(high, unit)}"
        return cls(what, figure(value, unit), goal, bool(low <= value <= high), note)

    @classmethod
    def context(cls, what: str, value: float, unit: str = "", note: str = "") -> Row:
        """Return a row without a goal: a figure that explains its neighbours."""
        return cls(what, figure(value, unit), note=note)

    @property
    def verdict(self) -> str:
        return {True: "yes", False: "NO", None: ""}[self.met]


def figure(value: float, unit: str = "") -> str:
    """Write a number with three significant digits, whole numbers whole, and its unit."""
    if not math.isfinite(value):
        text = str(value)
    elif float(value).is_integer() or abs(value) >= 1000:
        text = f"{value:,.0f}"
    else:
        text = f"{value:#.3g}".rstrip(".")
    return f"{text} {unit}".rstrip()


def markdown(rows: Iterable[Row]) -> str:
    """Return the rows as a Markdown table."""
    lines = ["| what | measured | goal | met | how |", "|---|---|---|---|---|"]
    lines += [f"| {r.what} | {r.measured} | {r.goal} | {r.verdict} | {r.note} |" for r in rows]
    return "\n".join(lines) + "\n"


def with_section(document: str, name: str, body: str) -> str:
    """Return the document with section `name` (a `## ` heading) replaced, or appended where it is new."""
    head, *sections = document.split("\n## ")
    bodies = {section.split("\n", 1)[0].strip(): section.split("\n", 1)[1] for section in sections}
    bodies[name] = "\n" + body
    parts = [
        head.rstrip("\n") + "\n",
        *(f"\n## {title}\n{bodies[title].rstrip()}\n" for title in sorted(bodies)),
    ]
    return "".join(parts)
