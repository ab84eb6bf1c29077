"""One look for all plots, and the same bytes for the same figures.

Text is drawn as outlines, so that a plot looks the same wherever it is shown and asks no one for a font; what it says
is in the document's title and description too, for screen readers. The background is white paper, whatever
is around it.
"""

from __future__ import annotations

import io
import math
import textwrap
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from app.markup import element_text, legal_text

INK, FAINT = "#222222", "#8a8a8a"
BLUE, ORANGE, GREEN, RED, SKY = "#0072b2", "#d55e00", "#009e73", "#c1272d", "#9ec9e2"
"""Distinguishable with red-green colour blindness too (Okabe and Ito, 2008), in grey by their marks."""
NAVY = "#00365a"
"""Apart from `FAINT` in grey, too, where no mark differs."""
NORMAL_95 = 1.959964
"""Coverage factor of a normal figure's 95 % interval."""

_STYLE: Any = {
    "svg.fonttype": "path",
    "svg.hashsalt": "gridpose",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "figure.dpi": 72,
    "savefig.dpi": 144,  # of rasterised parts; the rest is vector graphics
    "font.family": ["DejaVu Sans"],
    "font.size": 9.0,
    "text.parse_math": False,  # a dollar in a name is a dollar
    "text.color": INK,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.labelsize": 9.0,
    "axes.titlesize": 9.5,
    "axes.linewidth": 0.8,
    "axes.formatter.useoffset": False,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.2,
}


_PANEL_LEFT, _PANEL_WIDTH, _PANEL_HEIGHT, _PANEL_GAP = 0.8, 4.1, 1.75, 0.85
_PANEL_HEADER, _PANEL_CAPTION, _PANEL_BELOW = 0.85, 0.63, 0.62
"""Of a grid of panels with three lines above each; inches."""
_LETTER, _LINE = 0.085, 0.17
"""Room for a letter of small type, wide ones included, and from line to line; inches."""
_BOLD_POINTS_PER_INCH = 116.0
"""Size of bold letters of which one takes an inch, on average of a title."""


@contextmanager
def drawing_style() -> Iterator[None]:
    """Draw by this look alone, whatever a matplotlibrc on this machine says."""
    with mpl.rc_context(), warnings.catch_warnings():
        # A name may hold letters that the font has not; a box in their place is no reason to draw nothing.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def draw_svg(draw: Callable[[], Figure], title: str, description: str, about: str = "") -> bytes:
    """Return what `draw` makes as an SVG document; the same drawing gives the same bytes.

    `about` says what is drawn of which session, robot and date; it stands above the drawing and in the title.
    """
    stream = io.StringIO()
    with drawing_style():
        figure = draw()
        if about:
            head_with(figure, about)
        figure.savefig(
            stream, format="svg", metadata={"Creator": None, "Date": None, "Format": None, "Type": None}
        )
    if about:
        title = f"{title}: {about}"
    drawn = legal_text(stream.getvalue())  # the text of every outline is in a comment
    # The document type names a file of another host; no reader needs it.
    head, rest = drawn[drawn.index("<svg") :].split(">", 1)
    accessible = f"<title>{element_text(title)}</title>\n <desc>{element_text(description)}</desc>"
    return f'<?xml version="1.0" encoding="utf-8"?>\n{head} role="img">\n {accessible}{rest}'.encode()


def head_with(figure: Figure, about: str) -> None:
    """Write lines above a drawing, which becomes as much higher; nothing in it is moved or scaled."""
    width, height = figure.get_size_inches()
    lines = textwrap.wrap(legal_text(about), int((width - 0.3) / _LETTER))
    added = _LINE * len(lines) + 0.06
    share = height / (height + added)
    for axes in figure.axes:
        box = axes.get_position(original=True)
        axes.set_position((box.x0, box.y0 * share, box.width, box.height * share))
    for text in figure.texts:
        text.set_y(text.get_position()[1] * share)
    figure.set_size_inches(width, height + added)
    for number, line in enumerate(lines):
        text_at(figure, 0.15, 0.2 + _LINE * number, line, fontsize=8.5, color="#555555")


def axes_at(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Return axes whose box is given in inches from the figure's upper left corner."""
    across, down = figure.get_size_inches()
    return figure.add_axes((left / across, 1.0 - (top + height) / down, width / across, height / down))


def title_at(figure: Figure, title: str, fontsize: float = 12.0) -> None:
    """Write a drawing's title, in smaller letters where it would not fit the width."""
    room = (figure.get_size_inches()[0] - 0.3) / max(len(title), 1)
    text_at(figure, 0.15, 0.32, title, fontsize=min(fontsize, _BOLD_POINTS_PER_INCH * room), weight="bold")


def text_at(figure: Figure, left: float, top: float, text: str, **style: Any) -> None:
    """Write a line, its place given in inches from the figure's upper left corner."""
    across, down = figure.get_size_inches()
    figure.text(left / across, 1.0 - top / down, legal_text(text), va="baseline", **style)


@dataclass(frozen=True, slots=True)
class PanelText:
    """The three lines above a panel; the name's colour says whether it wants attention."""

    name: str
    caption: str
    detail: str
    colour: str = INK


def panel_grid(
    panels: Sequence[PanelText], title: str, summary: str, footer: float, draw: Callable[[Axes, int], None]
) -> Figure:
    """Return a figure of panels in two columns under a title and a summary; within `drawing_style`.

    `draw` fills the axes of the panel of that number; `footer` is the room left for a legend, inches.
    """
    columns = 1 if len(panels) == 1 else 2
    row = _PANEL_CAPTION + _PANEL_HEIGHT + _PANEL_BELOW
    width = _PANEL_LEFT + columns * _PANEL_WIDTH + (columns - 1) * _PANEL_GAP + 0.25
    figure = Figure((max(width, 6.6), _PANEL_HEADER + row * math.ceil(len(panels) / columns) + footer))
    title_at(figure, title, 12 if columns == 2 else 9.5)
    text_at(figure, 0.15, 0.56, summary, fontsize=9)
    for number, panel in enumerate(panels):
        left = _PANEL_LEFT + (number % columns) * (_PANEL_WIDTH + _PANEL_GAP)
        top = _PANEL_HEADER + (number // columns) * row
        text_at(figure, left, top + 0.1, short(panel.name), fontsize=10, weight="bold", color=panel.colour)
        text_at(figure, left, top + 0.31, panel.caption)
        text_at(figure, left, top + 0.5, panel.detail, color="#555555", fontsize=8)
        draw(axes_at(figure, left, top + _PANEL_CAPTION, _PANEL_WIDTH, _PANEL_HEIGHT), number)
    return figure


def short(name: str) -> str:
    """Return a name as it fits a line and can be drawn."""
    name = legal_text(name)
    return name if len(name) <= 40 else name[:39] + "…"


def unsigned_zero(text: str) -> str:
    """Return the text of a number with a true minus sign, and none before a zero."""
    return text.lstrip("-") if not text.strip("-0.") else text.replace("-", "−")


def millimetres(value: float) -> str:
    """Return three digits, or 0 below a nanometre."""
    if value < 1e-6:
        return "0"
    if not 1e-3 <= value < 1e3:
        return f"{value:.3g}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(value)))}f}"
