"""A goal, and the rows of which sections measure it."""

from __future__ import annotations

import math
from dataclasses import dataclass

INDEPENDENT = "measured on this repository's own scenes; the goal's are others"
"""Note of many goals."""


@dataclass(frozen=True, slots=True)
class Part:
    """Rows of one section, and the limits of the figures in them.

    `rows` is a regular expression that the whole of a row's `what` matches. With `own`, the goal that the row states
    for itself decides: it is relative to another figure of the same run.
    """

    section: str
    rows: str
    low: float = -math.inf
    high: float = math.inf
    own: bool = False


@dataclass(frozen=True, slots=True)
class Goal:
    """One row of the table: `note` says what the figures do not cover, and why."""

    what: str
    goal: str
    parts: tuple[Part, ...] = ()
    note: str = ""


def at_most(section: str, rows: str, limit: float) -> Part:
    """Return rows whose figures have an upper limit."""
    return Part(section, rows, high=limit)


def at_least(section: str, rows: str, limit: float) -> Part:
    """Return rows whose figures have a lower limit."""
    return Part(section, rows, low=limit)
