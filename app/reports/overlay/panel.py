"""The panel below an overlay's image: verdict, reason, advice, figures and the legend of the marks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from app.reports.overlay.content import Statement
from app.reports.overlay.lettering import Colour, Type, text_width, wrapped, write

PAPER: Colour = (250, 250, 250)
_INK: Colour = (32, 32, 32)
_FAINT: Colour = (100, 100, 100)
_VERDICTS: dict[str, Colour] = {
    "measured": (60, 140, 30),
    "refused": (40, 40, 200),
    "waiting": (140, 110, 60),
}
_MAX_SENTENCE_LINES = 40

Swatch = Callable[[UInt8[np.ndarray, "h w 3"], Float[np.ndarray, "2"]], None]
"""Draws an example of a mark about a place."""


@dataclass(frozen=True, slots=True)
class LegendEntry:
    """A mark and what it means."""

    swatch: Swatch
    text: str


def text_size(width_px: int) -> float:
    """Return the size of a panel's letters, px, for a drawing of this width."""
    return 7.0 + width_px / 90


def draw_panel(
    width_px: int, statement: Statement, legend: Sequence[LegendEntry]
) -> UInt8[np.ndarray, "h w 3"]:
    """Return the panel of a drawing of this width, as high as its text is long."""
    size = text_size(width_px)
    title, body, small = Type.of(1.2 * size, is_bold=True), Type.of(size), Type.of(0.85 * size)
    margin = round(0.8 * body.size_px)
    inner = width_px - 2 * margin
    titles = wrapped([statement.title], inner - margin, title)
    sentences = wrapped(statement.sentences, inner, body)[:_MAX_SENTENCE_LINES]
    figures = wrapped(statement.figures, inner, small)
    rows = _rows(legend, inner, small)
    gap = margin // 2
    blocks = [
        (titles, title, _VERDICTS[statement.verdict]),
        (sentences, body, _INK),
        (figures, small, _FAINT),
    ]
    height = 2 * margin + sum(len(lines) * kind.line_px + (gap if lines else 0) for lines, kind, _ in blocks)
    height += len(rows) * _row_px(small)
    panel = np.full((height, width_px, 3), PAPER, dtype=np.uint8)
    cv2.rectangle(panel, (0, 0), (margin // 2, height), _VERDICTS[statement.verdict], cv2.FILLED)
    top = margin
    for lines, kind, colour in blocks:
        for line in lines:
            write(panel, line, margin + margin // 2, top + round(1.05 * kind.size_px), kind, colour)
            top += kind.line_px
        top += gap if lines else 0
    for row in rows:
        _draw_row(panel, row, margin + margin // 2, top, small)
        top += _row_px(small)
    return panel


def _row_px(kind: Type) -> int:
    return round(1.9 * kind.size_px)


def _swatch_px(kind: Type) -> int:
    return 2 * kind.size_px


def _rows(legend: Sequence[LegendEntry], width_px: int, kind: Type) -> list[list[LegendEntry]]:
    """Return the legend's entries line by line."""
    rows: list[list[LegendEntry]] = []
    used = width_px + 1
    for entry in legend:
        wide = _swatch_px(kind) + text_width(entry.text, kind) + 2 * kind.size_px
        if used + wide > width_px:
            rows.append([])
            used = 0
        rows[-1].append(entry)
        used += wide
    return rows


def _draw_row(
    panel: UInt8[np.ndarray, "h w 3"], row: Sequence[LegendEntry], left: int, top: int, kind: Type
) -> None:
    middle = top + _row_px(kind) / 2
    for entry in row:
        entry.swatch(panel, np.array([left + 0.8 * kind.size_px, middle]))
        left += _swatch_px(kind)
        write(panel, entry.text, left, round(middle + 0.36 * kind.size_px), kind, _INK)
        left += text_width(entry.text, kind) + 2 * kind.size_px
