"""How the poses moved from the first cycles to the last (ISO 9283:1998, 7.6)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from app.reports.svg import BLUE, GREEN, INK, ORANGE, axes_at, draw_svg, millimetres, short, text_at

_AXES = (("x", BLUE, "o"), ("y", ORANGE, "s"), ("z", GREEN, "^"))
_LEFT, _PANEL_WIDTH, _PANEL_HEIGHT, _GAP = 0.8, 4.1, 1.75, 0.85
_MAX_VECTORS = 3000
"""Points that are drawn one by one; more of them are rasterised, or the file would have megabytes."""
_HEADER, _CAPTION, _BELOW, _FOOTER = 0.62, 0.64, 0.62, 0.7


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive cycles: their mean along x, y, z (mm) with its standard error, and their RP_l."""

    first_cycle: int
    last_cycle: int
    mean_mm: Float[np.ndarray, "3"]
    standard_error_mm: Float[np.ndarray, "3"]
    rp_mm: float


@dataclass(frozen=True, slots=True)
class PoseDrift:
    """Positions of one pose by cycle; `blocks` is empty where there are not two of them."""

    pose_id: str
    cycles: Int[np.ndarray, " n"]
    positions_mm: Float[np.ndarray, "n 3"]
    blocks: tuple[Block, ...]


def drift_svg(poses: Sequence[PoseDrift], title: str, block: int) -> bytes:
    """Return a panel for every pose, x, y and z over the cycles."""
    return draw_svg(
        lambda: drift_figure(poses, title, block),
        title,
        "\n".join(f"{p.pose_id}: {' '.join(_caption(p, block))}" for p in poses),
    )


def drift_figure(poses: Sequence[PoseDrift], title: str, block: int) -> Figure:
    """Draw it; within `drawing_style`."""
    columns = 1 if len(poses) == 1 else 2
    rows = math.ceil(len(poses) / columns)
    row = _CAPTION + _PANEL_HEIGHT + _BELOW
    width = _LEFT + columns * _PANEL_WIDTH + (columns - 1) * _GAP + 0.25
    figure = Figure((max(width, 6.6), _HEADER + row * rows + _FOOTER))
    text_at(figure, 0.15, 0.32, title, fontsize=12 if columns == 2 else 9.5, weight="bold")
    rasterized = sum(pose.positions_mm.size for pose in poses) > _MAX_VECTORS
    for place, pose in enumerate(poses):
        left = _LEFT + (place % columns) * (_PANEL_WIDTH + _GAP)
        top = _HEADER + (place // columns) * row
        first, second = _caption(pose, block)
        text_at(figure, left, top + 0.1, short(pose.pose_id), fontsize=10, weight="bold")
        text_at(figure, left, top + 0.31, first)
        text_at(figure, left, top + 0.51, second, color="#555555", fontsize=8)
        _draw(axes_at(figure, left, top + _CAPTION, _PANEL_WIDTH, _PANEL_HEIGHT), pose, rasterized)
    figure.legend(
        handles=_legend(block), loc="lower center", ncols=2 * columns, columnspacing=1.6, handletextpad=0.6
    )
    return figure


def _caption(pose: PoseDrift, block: int) -> tuple[str, str]:
    n = len(pose.cycles)
    if not pose.blocks:
        return f"n = {n}", f"no blocks: drift needs two of {block} cycles"
    first, last = pose.blocks[0], pose.blocks[-1]
    shift = last.mean_mm - first.mean_mm
    uncertainty = np.hypot(first.standard_error_mm, last.standard_error_mm)
    unit, factor = _unit(float(np.abs(shift).max() + uncertainty.max()))
    digits = _digits(float(uncertainty.max()) * factor)
    along = ", ".join(_signed(value * factor, digits) for value in shift)
    errors = ", ".join(f"{value * factor:.{digits}f}" for value in uncertainty)
    length = float(np.linalg.norm(shift)) * factor
    return (
        f"n = {n}   ·   moved {length:.{digits}f} {unit}   ·   "
        f"RP_l {millimetres(first.rp_mm)} → {millimetres(last.rp_mm)} mm",
        f"x, y, z: {along} {unit} (standard errors {errors})",
    )


def _signed(value: float, digits: int) -> str:
    """Return a number with its sign; what rounds to zero has none."""
    text = f"{value:+.{digits}f}"
    return text[1:] if not text.strip("+-0.") else text.replace("-", "−")


def _draw(axes: Axes, pose: PoseDrift, rasterized: bool) -> None:
    origin = pose.blocks[0].mean_mm if pose.blocks else pose.positions_mm.mean(axis=0)
    offsets = pose.positions_mm - origin
    unit, factor = _unit(float(np.abs(offsets).max()))
    axes.axhline(0.0, color=INK, lw=0.7, zorder=1)
    for axis, (_, colour, marker) in enumerate(_AXES):
        axes.plot(
            pose.cycles + 0.16 * (axis - 1),
            offsets[:, axis] * factor,
            marker=marker,
            ms=3.0,
            mew=0,
            color=colour,
            alpha=0.55,
            ls="none",
            zorder=2,
            rasterized=rasterized,
        )
        x, middle, spread = _steps(pose.blocks, axis, origin[axis], factor)
        axes.fill_between(
            x, middle - spread, middle + spread, color=colour, alpha=0.16, lw=0, rasterized=rasterized
        )
        axes.plot(x, middle, color=colour, lw=1.7, zorder=3, rasterized=rasterized)
    axes.set_xlim(float(pose.cycles.min()) - 1.0, float(pose.cycles.max()) + 1.0)
    if not offsets.any():
        axes.set_ylim(-1.0, 1.0)
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel("cycle")
    axes.set_ylabel(f"off the {'first block' if pose.blocks else 'mean'}, {unit}", labelpad=2)


def _steps(
    blocks: Sequence[Block], axis: int, origin_mm: float, factor: float
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Return cycles, means and two standard errors of the blocks one after the other, with gaps (NaN) between."""
    x, middle, spread = np.full((3, len(blocks), 3), np.nan)
    for row, block in enumerate(blocks):
        x[row, :2] = block.first_cycle - 0.4, block.last_cycle + 0.4
        middle[row, :2] = (block.mean_mm[axis] - origin_mm) * factor
        spread[row, :2] = 2.0 * block.standard_error_mm[axis] * factor
    return x.ravel(), middle.ravel(), spread.ravel()


def _unit(reach_mm: float) -> tuple[str, float]:
    return ("mm", 1.0) if reach_mm >= 0.1 else ("µm", 1e3)


def _digits(uncertainty: float) -> int:
    """Return the decimals that show two digits of the uncertainty."""
    return 1 if uncertainty <= 0.0 else min(4, max(0, 1 - math.floor(math.log10(uncertainty))))


def _legend(block: int) -> list[Any]:
    return [
        *(
            Line2D(
                [], [], marker=marker, color=colour, ms=4, mew=0, lw=1.7, label=f"{name}: cycle, block mean"
            )
            for name, colour, marker in _AXES
        ),
        Patch(fc="#bbbbbb", lw=0, label=f"± 2 standard errors of a block of {block}"),
    ]
