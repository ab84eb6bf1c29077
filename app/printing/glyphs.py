"""Text as outlines, so that a sheet needs no font; DejaVu Sans, which is part of matplotlib."""

from __future__ import annotations

import warnings
from functools import cache, lru_cache
from pathlib import Path as File

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path as Curves
from matplotlib.textpath import TextToPath

from app.printing.outlines import Path, Step

LETTERS_MM = 1.8
"""Height of capitals."""


def text_width(text: str) -> float:
    """Return the width of a line in mm."""
    places, _ = _glyphs(text)
    return float(places[:, 0].max()) if len(places) else 0.0


def text_outlines(text: str, x: float, y: float, *, upward: bool = False) -> Path:
    """Return a line of text whose base line begins at (x, y), y down; `upward`: running up the sheet."""
    places, codes = _glyphs(text)
    across, up = places.T
    drawn = np.column_stack([x - up, y - across] if upward else [x + across, y - up])
    steps: list[Step] = []
    at, begun, k = np.zeros(2), np.zeros(2), 0
    while k < len(codes):
        code, here = codes[k], drawn[k]
        if code == Curves.CURVE3:  # a quadratic curve as a cubic one
            control, end = here, drawn[k + 1]
            arms = (at + 2.0 * (control - at) / 3.0, end + 2.0 * (control - end) / 3.0)
            steps.append(("C", tuple(np.concatenate([*arms, end]).tolist())))
            at, k = end, k + 2
            continue
        if code == Curves.CLOSEPOLY:
            steps.append(("Z", ()))
            at = begun
        else:
            steps.append(("M" if code == Curves.MOVETO else "L", tuple(here.tolist())))
            at = here
            begun = here if code == Curves.MOVETO else begun
        k += 1
    return tuple(steps)


@lru_cache(maxsize=256)
def _glyphs(text: str) -> tuple[Float[np.ndarray, "n 2"], list[int]]:
    """Return the vertices of outlines in mm, y up, and their path codes."""
    with warnings.catch_warnings():
        # A name may hold characters that are missing from the font: a box is drawn in their place.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        places, codes = _raw(text)
        capital, _ = _raw("H")
    return places / capital[:, 1].max() * LETTERS_MM, codes


def _raw(text: str) -> tuple[Float[np.ndarray, "n 2"], list[int]]:
    places, codes = TextToPath().get_text_path(_font(), text, ismath=False)
    return np.asarray(places, dtype=np.float64).reshape(-1, 2), [int(code) for code in codes]


@cache
def _font() -> FontProperties:
    return FontProperties(fname=str(File(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"))
