"""Intervals as bars: positions on one scale for all rows of a table, as attributes of SVG, which need no style."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from app.web.words import number

WIDTH = 180.0
_MARGIN = 6.0


@dataclass(frozen=True, slots=True)
class Bar:
    """One row's marks, in the bar's units: the value, its interval, the noise floor and the corrected value."""

    value: float
    low: float | None
    high: float | None
    floor: float | None
    corrected: float | None
    limit: float | None
    text: str


def bars_of(
    rows: Sequence[tuple[float | None, Sequence[float] | None, float | None, float | None]],
    limit: float | None = None,
) -> tuple[list[Bar | None], float]:
    """Return a bar for each (value, interval, floor, corrected), and the value at the right end of all of them."""
    reaches = [limit] if limit is not None else []
    for value, interval, floor, corrected in rows:
        reaches += [one for one in (value, floor, corrected, *(interval or ())) if one is not None]
    end = max(reaches, default=0.0) or 1.0
    scale = (WIDTH - 2.0 * _MARGIN) / end

    def place(value: float | None) -> float | None:
        return None if value is None else round(_MARGIN + value * scale, 2)

    bars: list[Bar | None] = []
    for value, interval, floor, corrected in rows:
        at = place(value)
        if at is None:
            bars.append(None)
            continue
        low, high = interval or (None, None)
        text = f"{number(value)} mm"
        if interval is not None:
            text += f", 95 % interval {number(low)} to {number(high)} mm"
        if floor is not None:
            text += f", noise floor {number(floor)} mm"
        bars.append(Bar(at, place(low), place(high), place(floor), place(corrected), place(limit), text))
    return bars, end
