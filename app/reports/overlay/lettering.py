"""Text of an overlay, in the outline font that OpenCV carries: measured, wrapped and written."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from jaxtyping import UInt8

from app.markup import legal_text

Colour = tuple[int, int, int]
"""Blue, green, red."""
_FACE = "sans"
_MIN_SIZE_PX = 10
_REGULAR, _BOLD = 420, 650


@dataclass(frozen=True, slots=True)
class Type:
    """Size (px) and weight of letters; `line_px` from one line to the next."""

    size_px: int
    weight: int

    @classmethod
    def of(cls, size_px: float, *, is_bold: bool = False) -> Type:
        return cls(max(_MIN_SIZE_PX, round(size_px)), _BOLD if is_bold else _REGULAR)

    @property
    def line_px(self) -> int:
        return round(1.42 * self.size_px)


@cache
def _face() -> cv2.FontFace:
    return cv2.FontFace(_FACE)


def text_width(text: str, kind: Type) -> int:
    """Return how wide a line is, px."""
    left, _, width, _ = cv2.getTextSize((0, 0), text, (0, 0), _face(), kind.size_px, kind.weight)
    return int(left + width)


def write(
    canvas: UInt8[np.ndarray, "h w 3"], text: str, left: int, baseline: int, kind: Type, colour: Colour
) -> None:
    """Write one line on the canvas."""
    cv2.putText(canvas, legal_text(text), (left, baseline), colour, _face(), kind.size_px, kind.weight)


def wrapped(texts: Iterable[str], width_px: int, kind: Type) -> list[str]:
    """Return lines that are at most so wide; a word that is wider alone is divided."""
    space = text_width("n n", kind) - text_width("nn", kind)
    lines: list[str] = []
    for text in texts:
        words = [
            (part, text_width(part, kind))
            for word in legal_text(text).split()
            for part in _parts(word, width_px, kind)
        ]
        line, used = "", 0
        for word, wide in words:
            if line and used + space + wide > width_px:
                lines.append(line)
                line, used = word, wide
            else:
                line, used = (f"{line} {word}", used + space + wide) if line else (word, wide)
        if line:
            lines.append(line)
    return lines


def _parts(word: str, width_px: int, kind: Type) -> list[str]:
    """Return a word, or its parts where it does not fit a line."""
    if len(word) < 2 or text_width(word, kind) <= width_px:
        return [word]
    half = len(word) // 2
    return [*_parts(word[:half], width_px, kind), *_parts(word[half:], width_px, kind)]
