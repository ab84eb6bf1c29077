"""A target on a sheet of paper: where it lies, the rulers beside it, and what the sheet says of itself.

Places are in mm from the paper's upper left corner, x to the right, y down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from app.printing.identity import sheet_id_of
from app.printing.lettering import text_outlines, text_width
from app.printing.outlines import Ink, Path, box, ink_of, moved
from app.printing.papers import SIZES_MM, Paper
from core import TargetSpec
from core.errors import InvalidArgument, InvalidTarget
from core.targets.detect import check_detectable
from core.targets.dot_refinement import ODD
from core.targets.marked_squares import marked_squares
from core.targets.target_fields import check_fields, spacing_mm

EDGE_MM = 6.0
"""Nothing is printed nearer to the paper's edge: printers leave some 4 mm white."""
QUIET = 0.25
"""White around the ink, at least, in pitches (of staggered dots in their distance)."""
WIDEST_ORIGIN = 2.4
"""Times as wide as the others: a wider dot has over six times their area, and is no longer taken for one of them
(`core.targets.dot_lattice`)."""
LEAST_PITCH_MM = 0.5
"""A printer of 600 points to the inch puts twelve into that, and its edges are already off by a tenth of it."""
_NOTE = (
    "Print at 100 % (actual size), never fitted to the page, and check with a steel rule: the marks along both sides "
    "are in mm. Grid point (0, 0) is at the upper left, x right, y down."
)
_LETTERS_MM = 1.8
_LINE_MM = 3.2
_TICK_MM, _HALF_MM, _LONG_MM = 2.2, 1.4, 3.4
_STROKE_MM, _CLEAR_MM = 0.15, 0.7
_RULER_MM = _LONG_MM + _CLEAR_MM + _LETTERS_MM
_GAP_MM = 1.2


@dataclass(frozen=True, slots=True)
class Ruler:
    """Marks at every 5 mm along x (below the target) or y (left of it), from `start` on, of `length` in all; `line` is
    where they begin across."""

    start: float
    length: float
    line: float


@dataclass(frozen=True, slots=True)
class Words:
    """A line of text: where its base line begins, and the height of its capitals."""

    text: str
    x: float
    y: float
    height: float
    upward: bool = False


@dataclass(frozen=True, slots=True)
class Sheet:
    """What is printed. `outlines` are filled black by the non-zero rule; letters are among them. `origin` is where grid
    point (0, 0) lies; `sheet_id` tells this target's prints from those of others, `title` says what it is."""

    target: TargetSpec
    sheet_id: str
    title: str
    paper: Paper
    origin: tuple[float, float]
    outlines: tuple[Path, ...]
    words: tuple[Words, ...]
    along_x: Ruler
    along_y: Ruler


def draw_sheet(
    target: TargetSpec,
    paper: str = "A4",
    *,
    origin_dot: float = 1.0,
    marks: bool = False,
    name: str | None = None,
) -> Sheet:
    """Return the sheet of a target at true scale, whichever way round the paper leaves more white around it.

    Parameters
    ----------
    paper
        A4 to A0.
    origin_dot
        How many times wider than the others the dot at the origin of a board of dots is.
    marks
        Draw the marked squares of a chessboard, by which its parts are told.
    name
        What the target is called, for the sheet's text.

    Raises
    ------
    InvalidArgument
        No such paper, a dot or marks that the target has not, or a target larger than the paper.
    InvalidTarget
        No such target can be printed, or none that could be found in a picture, or it is described by a field that
        its kind has not.
    """
    if paper not in SIZES_MM:
        raise InvalidArgument(f"Unknown paper {paper!r}.", f"Use one of {', '.join(SIZES_MM)}.")
    check_fields(target)
    check_detectable(target)
    if target.pitch_mm < LEAST_PITCH_MM:
        raise InvalidTarget(
            f"A pitch of {target.pitch_mm:g} mm cannot be printed: a printer's points are some .04 mm wide.",
            f"pitch_mm is in millimetres; {LEAST_PITCH_MM:g} is the least. Finer targets are made on glass.",
            field="pitch_mm",
        )
    _check_extras(target, origin_dot, marks)
    ink = ink_of(target, origin_dot=origin_dot, marks=marks)
    sheet_id = sheet_id_of(target, origin_dot, marks)
    told = (name, f"{sheet_id}: {describe(target, origin_dot, marks)}")
    identity = " · ".join(part for part in told if part)
    layouts = [_Layout.of(Paper(paper, upright), ink, target, identity) for upright in (True, False)]
    best = max(layouts, key=lambda layout: layout.slack)
    if best.slack < 0.0:
        raise _too_large(target, ink, paper, identity)
    return best.sheet(target, sheet_id, identity, ink)


def describe(target: TargetSpec, origin_dot: float = 1.0, marks: bool = False) -> str:
    """Return a target in a few words."""
    counted = {"chessboard": "inner corners", "charuco": "inner corners", "aprilgrid": "tags"}
    parts = [
        f"{target.kind} {target.columns} x {target.rows} {counted.get(target.kind, 'dots')}",
        f"pitch {target.pitch_mm:g} mm",
    ]
    if target.marker_mm is not None:
        round_ = target.kind in ("circles", "asymmetric_circles")
        parts.append(f"{'diameter' if round_ else 'marker'} {target.marker_mm:g} mm")
    if target.dictionary is not None:
        parts.append(target.dictionary)
    if target.legacy_layout:
        parts.append("legacy layout")
    if origin_dot != 1.0:
        parts.append(f"dot at the origin {origin_dot:g} times as wide")
    if marks:
        parts.append("marked squares")
    return ", ".join(parts)


def _check_extras(target: TargetSpec, origin_dot: float, marks: bool) -> None:
    if marks and not marked_squares(target):
        raise InvalidArgument(
            f"A {target.kind} of {target.columns} x {target.rows} grid points has no marked squares.",
            "They are for chessboards with room for four; leave --marks away.",
        )
    if origin_dot == 1.0:
        return
    if target.kind not in ("circles", "asymmetric_circles"):
        raise InvalidArgument(f"A {target.kind} has no dots.", "Leave --origin-dot away.")
    apart = spacing_mm(target)
    usual = target.marker_mm if target.marker_mm is not None else 0.5 * apart
    # a tenth of the way to each neighbour stays white
    most = min((1.8 * apart - usual) / usual, WIDEST_ORIGIN)
    if most <= 1.0 + ODD:
        raise InvalidArgument(
            f"Dots {usual:g} mm wide, {apart:.4g} mm apart, leave no room for a larger one at the origin.",
            "Leave --origin-dot away, or make the dots smaller: half of their distance serves best.",
        )
    if not 1.0 + ODD < origin_dot <= most:
        raise InvalidArgument(
            f"The dot at the origin must be more than {1.0 + ODD:g} times as wide as the others, or it is not told "
            f"from them, and {math.floor(100.0 * most) / 100.0:g} times at most, or it meets its neighbours or is not "
            f"taken for one of them; got {origin_dot:g}."
        )


@dataclass(frozen=True, slots=True)
class _Layout:
    """One way of laying a target onto a paper; `slack` is what it has to spare, negative where it does not fit."""

    paper: Paper
    lines: tuple[str, ...]
    free: tuple[float, float, float, float]
    """Left, top, right, bottom of where ink of the target may be."""
    slack: float
    scale: float
    """How many times larger the target could be."""

    @classmethod
    def of(cls, paper: Paper, ink: Ink, target: TargetSpec, identity: str) -> _Layout:
        lines = (
            *_wrapped(identity, paper.width_mm - 2.0 * EDGE_MM),
            *_wrapped(_NOTE, paper.width_mm - 2.0 * EDGE_MM),
        )
        quiet = QUIET * spacing_mm(target)
        free = (
            EDGE_MM + _RULER_MM + quiet,
            max(EDGE_MM, quiet),
            paper.width_mm - max(EDGE_MM, quiet),
            paper.height_mm - EDGE_MM - len(lines) * _LINE_MM - _GAP_MM - _RULER_MM - quiet,
        )
        room = (free[2] - free[0], free[3] - free[1])
        size = (ink.high[0] - ink.low[0], ink.high[1] - ink.low[1])
        slack = min(room[0] - size[0], room[1] - size[1])
        # The quiet zone grows with the target where it reaches beyond the paper's white edge.
        across = [
            _largest(paper.width_mm, EDGE_MM + _RULER_MM, size[0], quiet),
            _largest(paper.height_mm, EDGE_MM + len(lines) * _LINE_MM + _GAP_MM + _RULER_MM, size[1], quiet),
        ]
        return cls(paper, lines, free, slack, min(across))

    def sheet(self, target: TargetSpec, sheet_id: str, title: str, ink: Ink) -> Sheet:
        left, top, right, bottom = self.free
        dx = 0.5 * (left + right) - 0.5 * (ink.low[0] + ink.high[0])
        dy = 0.5 * (top + bottom) - 0.5 * (ink.low[1] + ink.high[1])
        base = self.paper.height_mm - EDGE_MM - len(self.lines) * _LINE_MM
        words = [
            Words(line, EDGE_MM, base + (k + 1) * _LINE_MM - 0.3 * _LETTERS_MM, _LETTERS_MM)
            for k, line in enumerate(self.lines)
        ]
        along_x = _ruler(EDGE_MM + _RULER_MM, self.paper.width_mm - EDGE_MM - 3.0, base - _GAP_MM - _RULER_MM)
        along_y = _ruler(EDGE_MM, base - _GAP_MM - _RULER_MM - 3.0, EDGE_MM + _RULER_MM)
        ticks = [*_ticks(along_x, words, upward=False), *_ticks(along_y, words, upward=True)]
        letters = [text_outlines(w.text, w.x, w.y, w.height, upward=w.upward) for w in words]
        return Sheet(
            target=target,
            sheet_id=sheet_id,
            title=title,
            paper=self.paper,
            origin=(dx, dy),
            outlines=(*(moved(path, dx, dy) for path in ink.outlines), *ticks, *letters),
            words=tuple(words),
            along_x=along_x,
            along_y=along_y,
        )


def _largest(paper_mm: float, taken_mm: float, size_mm: float, quiet_mm: float) -> float:
    """Return how many times larger a target of this size with its quiet zone may be, beside what else is taken."""
    by_edge = (paper_mm - taken_mm - EDGE_MM) / (size_mm + quiet_mm)
    by_quiet = (paper_mm - taken_mm) / (size_mm + 2.0 * quiet_mm)
    return min(by_edge, by_quiet)


def _wrapped(text: str, width_mm: float) -> list[str]:
    gap = text_width("n n", _LETTERS_MM) - 2.0 * text_width("n", _LETTERS_MM)
    lines: list[list[str]] = []
    reach = math.inf
    for word in text.split():
        width = text_width(word, _LETTERS_MM)
        if reach + gap + width <= width_mm:
            lines[-1].append(word)
            reach += gap + width
        else:
            lines.append([word])
            reach = width
    return [" ".join(words) for words in lines]


def _ruler(low: float, high: float, line: float) -> Ruler:
    return Ruler(low, 10.0 * math.floor((high - low) / 10.0), line)


def _ticks(ruler: Ruler, words: list[Words], *, upward: bool) -> list[Path]:
    """Return a ruler's marks, and add its figures to the words; `upward`: of the ruler on the left."""
    half, ticks = 0.5 * _STROKE_MM, []
    for k in range(round(ruler.length / 5.0) + 1):
        figured = k % 10 == 0 or 5.0 * k == ruler.length
        length = _LONG_MM if figured else _TICK_MM if k % 2 == 0 else _HALF_MM
        at = ruler.start + 5.0 * k
        if upward:
            ticks.append(box(ruler.line - length, at - half, ruler.line, at + half))
        else:
            ticks.append(box(at - half, ruler.line, at + half, ruler.line + length))
        if figured:
            words.append(_beside(str(5 * k), at, ruler, upward=upward))
    words.append(_beside("mm", ruler.start + 25.0, ruler, upward=upward))
    return ticks


def _beside(text: str, at: float, ruler: Ruler, *, upward: bool) -> Words:
    """Return words whose middle lies beside a place of a ruler."""
    half = 0.5 * text_width(text, _LETTERS_MM)
    if upward:
        return Words(text, ruler.line - _LONG_MM - _CLEAR_MM, at + half, _LETTERS_MM, upward)
    return Words(text, at - half, ruler.line + _RULER_MM, _LETTERS_MM)


def _too_large(target: TargetSpec, ink: Ink, paper: str, identity: str) -> InvalidArgument:
    width, height = ink.high[0] - ink.low[0], ink.high[1] - ink.low[1]

    def largest(name: str) -> float:
        return max(_Layout.of(Paper(name, upright), ink, target, identity).scale for upright in (True, False))

    names = list(SIZES_MM)
    room = next((name for name in names[names.index(paper) + 1 :] if largest(name) >= 1.0), None)
    pitch = math.floor(10.0 * target.pitch_mm * largest(paper)) / 10.0
    ways = []
    if room is not None:
        ways.append(f"print on {room}")
    if pitch > 0.0:
        ways.append(f"use a pitch of {pitch:g} mm at most")
    ways.append("fewer columns and rows")
    advice = f"{ways[0][0].upper()}{ways[0][1:]}" + "".join(f", or {way}" for way in ways[1:]) + "."
    return InvalidArgument(f"The target is {width:.5g} x {height:.5g} mm, too large for {paper}.", advice)
