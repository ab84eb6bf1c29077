"""The standard uncertainty of a figure of a report, from what the report states next to it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

_UNIT = re.compile(r"(_(?:mm|deg|px|mrad|rad))?(\[\d+\])?$")
_WIDTH = 4.0
"""Of a 95 % interval, in standard uncertainties."""


def standard_uncertainty(figures: Mapping[str, Any], name: str) -> float | None:
    """Return the standard uncertainty of the figure `name` of `app.reports.forms.figures_of`; None where none is known.

    From its own, or from the width of its interval. That of an interval's end is the figure's, that of an uncertainty
    is this itself.
    """
    if "standard_uncertainty" in name or "expanded_uncertainty" in name:
        return _positive(figures.get(name))
    base, end = name[:-3], name[-3:]
    if "interval" in name and end in ("[1]", "[2]"):
        return _of_interval(figures, base)
    for uncertainty in _uncertainties(name):
        found = _positive(figures.get(uncertainty))
        if found is not None:
            return found
    for interval in _intervals(name):
        found = _of_interval(figures, interval)
        if found is not None:
            return found
    return None


def _uncertainties(name: str) -> Iterator[str]:
    """Yield where a report has the uncertainty of a figure: in a group next to it or to its group, or by its name."""
    group, _, leaf = name.rpartition(".")
    unit = _UNIT.search(leaf)
    assert unit is not None, "it may match nothing"
    stem, suffix = leaf[: unit.start()], unit[0]
    yield f"{group}.standard_uncertainty.{leaf}"
    yield f"{group.rpartition('.')[0]}.standard_uncertainty.{leaf}"
    yield f"{group}.{stem}_standard_uncertainty{suffix}"
    if stem in ("mean", "value"):  # of a distance, and of a budget's row
        yield f"{group}.standard_uncertainty{suffix}"


def _intervals(name: str) -> Iterator[str]:
    """Yield where a report has the interval of a figure, as its uncertainty."""
    group, _, leaf = name.rpartition(".")
    above, _, of_group = group.rpartition(".")
    yield f"{group}.interval.{leaf}"
    yield f"{above}.{of_group}_interval.{leaf}"
    if of_group in ("repeatability", "held_out"):
        yield f"{above}.interval.{leaf}"
    stem, _, unit = leaf.rpartition("_")
    yield f"{group}.{stem}_interval_{unit}"
    if stem == "rd":
        yield f"{group}.interval_{unit}"


def _of_interval(figures: Mapping[str, Any], name: str) -> float | None:
    low, high = (figures.get(f"{name}[{place}]") for place in (1, 2))
    return None if low is None or high is None else _positive((high - low) / _WIDTH)


def _positive(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and value > 0.0 else None
