"""Layout of a target on paper: position, scale bars, text.

Positions are in mm from the paper's upper left corner, x to the right, y down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from app.printing.glyphs import LETTERS_MM, text_outlines, text_width
from app.printing.outlines import Outlines, Path, box, translated
from core import TargetSpec
from core.targets import spacing_mm

PAPER_SIZES_MM = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
}
"""Width and height upright (ISO 216), smallest first."""
EDGE_MM = 6.0
"""Unprinted margin of the paper: printers leave about 4 mm white."""
MIN_QUIET = 0.25
"""White around the target in pitches (for asymmetric circles, in distances of neighbouring dots)."""
_NOTE = (
    "Print at 100 % (actual size), never fitted to the page, and check with a steel rule: the marks along both sides "
    "are in mm. Grid point (0, 0) is at the upper left, x right, y down."
)
_LINE_MM = 3.2
_TICK_MM, _HALF_MM, _LONG_MM = 2.2, 1.4, 3.4
_STROKE_MM, _CLEAR_MM = 0.15, 0.7
_BAR_MM = _LONG_MM + _CLEAR_MM + LETTERS_MM
_GAP_MM = 1.2


@dataclass(frozen=True, slots=True)
class Paper:
    """A sheet of paper: upright (portrait), or landscape."""

    name: str
    upright: bool

    @property
    def width_mm(self) -> float:
        return PAPER_SIZES_MM[self.name][0 if self.upright else 1]

    @property
    def height_mm(self) -> float:
        return PAPER_SIZES_MM[self.name][1 if self.upright else 0]

    def __str__(self) -> str:
        return f"{self.name} {'portrait' if self.upright else 'landscape'}"


@dataclass(frozen=True, slots=True)
class ScaleBar:
    """Marks at every 5 mm along x (below the target) or y (left of it), from `start`, of `length`; `line` is the other
    coordinate of the marks' ends."""

    start: float
    length: float
    line: float


@dataclass(frozen=True, slots=True)
class Text:
    """A line of text, and where its base line starts; its capitals are `LETTERS_MM` high."""

    text: str
    x: float
    y: float
    upward: bool = False


@dataclass(frozen=True, slots=True)
class Sheet:
    """A sheet to print. `outlines`, which include the letters, are filled black by the non-zero rule. `origin` is the
    position of grid point (0, 0), `sheet_id` identifies the printed target, `title` describes it."""

    target: TargetSpec
    sheet_id: str
    title: str
    paper: Paper
    origin: tuple[float, float]
    outlines: tuple[Path, ...]
    texts: tuple[Text, ...]
    along_x: ScaleBar
    along_y: ScaleBar


@dataclass(frozen=True, slots=True)
class Layout:
    """A target on a paper in one orientation; `slack` (mm) is negative where it does not fit."""

    paper: Paper
    lines: tuple[str, ...]
    free: tuple[float, float, float, float]
    """Left, top, right, bottom of the area for the target."""
    slack: float
    scale: float
    """Factor by which the target could be enlarged."""

    @classmethod
    def of(cls, paper: Paper, outlines: Outlines, target: TargetSpec, identity: str) -> Layout:
        lines = (
            *_wrapped(identity, paper.width_mm - 2.0 * EDGE_MM),
            *_wrapped(_NOTE, paper.width_mm - 2.0 * EDGE_MM),
        )
        quiet = MIN_QUIET * spacing_mm(target)
        free = (
            EDGE_MM + _BAR_MM + quiet,
            max(EDGE_MM, quiet),
            paper.width_mm - max(EDGE_MM, quiet),
            paper.height_mm - EDGE_MM - len(lines) * _LINE_MM - _GAP_MM - _BAR_MM - quiet,
        )
        room = (free[2] - free[0], free[3] - free[1])
        size = (outlines.high[0] - outlines.low[0], outlines.high[1] - outlines.low[1])
        slack = min(room[0] - size[0], room[1] - size[1])
        # The quiet zone grows with the target where it is wider than the margin.
        across = [
            _largest(paper.width_mm, EDGE_MM + _BAR_MM, size[0], quiet),
            _largest(paper.height_mm, EDGE_MM + len(lines) * _LINE_MM + _GAP_MM + _BAR_MM, size[1], quiet),
        ]
        return cls(paper, lines, free, slack, min(across))

    def sheet(self, target: TargetSpec, sheet_id: str, title: str, outlines: Outlines) -> Sheet:
        left, top, right, bottom = self.free
        dx = 0.5 * (left + right) - 0.5 * (outlines.low[0] + outlines.high[0])
        dy = 0.5 * (top + bottom) - 0.5 * (outlines.low[1] + outlines.high[1])
        base = self.paper.height_mm - EDGE_MM - len(self.lines) * _LINE_MM
        texts = [
            Text(line, EDGE_MM, base + (k + 1) * _LINE_MM - 0.3 * LETTERS_MM)
            for k, line in enumerate(self.lines)
        ]
        along_x = _scale_bar(EDGE_MM + _BAR_MM, self.paper.width_mm - EDGE_MM - 3.0, base - _GAP_MM - _BAR_MM)
        along_y = _scale_bar(EDGE_MM, base - _GAP_MM - _BAR_MM - 3.0, EDGE_MM + _BAR_MM)
        ticks = [*_ticks(along_x, texts, upward=False), *_ticks(along_y, texts, upward=True)]
        letters = [text_outlines(w.text, w.x, w.y, upward=w.upward) for w in texts]
        return Sheet(
            target=target,
            sheet_id=sheet_id,
            title=title,
            paper=self.paper,
            origin=(dx, dy),
            outlines=(*(translated(path, dx, dy) for path in outlines.paths), *ticks, *letters),
            texts=tuple(texts),
            along_x=along_x,
            along_y=along_y,
        )


def _largest(paper_mm: float, taken_mm: float, size_mm: float, quiet_mm: float) -> float:
    """Return the factor by which a target with its quiet zone can be enlarged; `taken_mm` is used otherwise."""
    by_edge = (paper_mm - taken_mm - EDGE_MM) / (size_mm + quiet_mm)
    by_quiet = (paper_mm - taken_mm) / (size_mm + 2.0 * quiet_mm)
    return min(by_edge, by_quiet)


def _wrapped(text: str, width_mm: float) -> list[str]:
    gap = text_width("n n") - 2.0 * text_width("n")
    lines: list[list[str]] = []
    reach = math.inf
    for word in text.split():
        width = text_width(word)
        if reach + gap + width <= width_mm:
            lines[-1].append(word)
            reach += gap + width
        else:
            lines.append([word])
            reach = width
    return [" ".join(words) for words in lines]


def _scale_bar(low: float, high: float, line: float) -> ScaleBar:
    return ScaleBar(low, 10.0 * math.floor((high - low) / 10.0), line)


def _ticks(bar: ScaleBar, texts: list[Text], *, upward: bool) -> list[Path]:
    """Return the marks of a scale bar, and append its numbers to `texts`; `upward`: the bar on the left."""
    half, ticks = 0.5 * _STROKE_MM, []
    for k in range(round(bar.length / 5.0) + 1):
        labelled = k % 10 == 0 or 5.0 * k == bar.length
        length = _LONG_MM if labelled else _TICK_MM if k % 2 == 0 else _HALF_MM
        at = bar.start + 5.0 * k
        if upward:
            ticks.append(box(bar.line - length, at - half, bar.line, at + half))
        else:
            ticks.append(box(at - half, bar.line, at + half, bar.line + length))
        if labelled:
            texts.append(_centred(str(5 * k), at, bar, upward=upward))
    texts.append(_centred("mm", bar.start + 25.0, bar, upward=upward))
    return ticks


def _centred(text: str, at: float, bar: ScaleBar, *, upward: bool) -> Text:
    """Return text centred at a position of a scale bar."""
    half = 0.5 * text_width(text)
    if upward:
        return Text(text, bar.line - _LONG_MM - _CLEAR_MM, at + half, upward)
    return Text(text, at - half, bar.line + _BAR_MM)
