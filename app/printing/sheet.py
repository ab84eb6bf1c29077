"""Sheets of a target: validation, description, and the orientation of the paper that leaves more white."""

from __future__ import annotations

import math

from app.markup import legal_text
from app.printing.layout import PAPER_SIZES_MM, Layout, Paper, Sheet
from app.printing.outlines import Outlines, pattern_outlines
from app.printing.sheet_id import sheet_id_of
from core import TargetSpec
from core.errors import InvalidArgument, InvalidTarget
from core.targets import ODD, check_detectable, check_fields, marked_squares, spacing_mm

MAX_ORIGIN_DOT_RATIO = 2.4
"""Diameter of the origin dot relative to the others: detection rejects a dot of more than six times their area."""
MIN_PITCH_MM = 0.5
"""Twelve dots of a printer of 600 dpi, whose edges are off by a tenth of this pitch."""


def draw_sheet(
    target: TargetSpec,
    paper: str = "A4",
    *,
    origin_dot: float = 1.0,
    marks: bool = False,
    name: str | None = None,
) -> Sheet:
    """Return the sheet of a target at true scale, in the orientation that leaves more white around it.

    Parameters
    ----------
    paper
        A4 to A0.
    origin_dot
        Diameter of the dot at the origin of a dot grid, relative to the others.
    marks
        Draw the fiducial dots of a chessboard, by which a partial view is matched to the board.
    name
        Name of the target in the sheet's text.

    Raises
    ------
    InvalidArgument
        Unknown paper, a dot or marks that this kind of target does not have, or a target larger than the paper.
    InvalidTarget
        The target cannot be printed or detected, or has a field that its kind does not have.
    """
    if paper not in PAPER_SIZES_MM:
        raise InvalidArgument(f"Unknown paper {paper!r}.", f"Use one of {', '.join(PAPER_SIZES_MM)}.")
    check_fields(target)
    check_detectable(target)
    if target.pitch_mm < MIN_PITCH_MM:
        raise InvalidTarget(
            f"A pitch of {target.pitch_mm:g} mm cannot be printed: a printer's dots are about 0.04 mm wide.",
            f"pitch_mm is in millimetres; {MIN_PITCH_MM:g} is the minimum. Finer targets are made on glass.",
            field="pitch_mm",
        )
    _check_extras(target, origin_dot, marks)
    outlines = pattern_outlines(target, origin_dot=origin_dot, marks=marks)
    sheet_id = sheet_id_of(target, origin_dot, marks)
    parts = (legal_text(name or ""), f"{sheet_id}: {describe(target, origin_dot, marks)}")
    identity = " · ".join(part for part in parts if part)
    layouts = [Layout.of(Paper(paper, upright), outlines, target, identity) for upright in (True, False)]
    best = max(layouts, key=lambda layout: layout.slack)
    if best.slack < 0.0:
        raise _too_large(target, outlines, paper, identity)
    return best.sheet(target, sheet_id, identity, outlines)


def describe(target: TargetSpec, origin_dot: float = 1.0, marks: bool = False) -> str:
    """Return a short description of a target."""
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
            "They need a chessboard with room for four; omit --fiducials.",
        )
    if origin_dot == 1.0:
        return
    if target.kind not in ("circles", "asymmetric_circles"):
        raise InvalidArgument(f"A {target.kind} has no dots.", "Omit --origin-dot-ratio.")
    apart = spacing_mm(target)
    usual = target.marker_mm if target.marker_mm is not None else 0.5 * apart
    # a tenth of the distance to each neighbour stays white
    most = min((1.8 * apart - usual) / usual, MAX_ORIGIN_DOT_RATIO)
    if most <= 1.0 + ODD:
        raise InvalidArgument(
            f"Dots {usual:g} mm wide, {apart:.4g} mm apart, leave no room for a larger one at the origin.",
            "Omit --origin-dot-ratio, or make the dots smaller: half of their distance is best.",
        )
    if not 1.0 + ODD < origin_dot <= most:
        raise InvalidArgument(
            f"The dot at the origin must be more than {1.0 + ODD:g} times as wide as the others, to be distinguished, "
            f"and at most {math.floor(100.0 * most) / 100.0:g} times, to be detected and not to touch its neighbours; "
            f"got {origin_dot:g}."
        )


def _too_large(target: TargetSpec, outlines: Outlines, paper: str, identity: str) -> InvalidArgument:
    width, height = outlines.high[0] - outlines.low[0], outlines.high[1] - outlines.low[1]

    def largest(name: str) -> float:
        return max(
            Layout.of(Paper(name, upright), outlines, target, identity).scale for upright in (True, False)
        )

    names = list(PAPER_SIZES_MM)
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
