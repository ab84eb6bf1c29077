"""How the poses moved from the first cycles to the last (ISO 9283:1998, 7.6): a panel for each axis."""

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

from app.reports.svg import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    axes_at,
    draw_svg,
    millimetres,
    short,
    text_at,
    title_at,
    unsigned_zero,
)

_AXES = (("x", BLUE, "o"), ("y", ORANGE, "s"), ("z", GREEN, "^"))
_LEFT, _PANEL_WIDTH, _STRIP, _BETWEEN, _GAP = 0.85, 4.1, 0.82, 0.1, 0.9
_MAX_VECTORS = 3000
"""Points that are drawn one by one; more of them are rasterised, or the file would have megabytes."""
_HEADER, _CAPTION, _BELOW, _FOOTER = 0.62, 1.0, 0.66, 0.78

_CHANCE: dict[str, Any] = {"color": INK, "lw": 0.9, "ls": (0, (3, 2))}


@dataclass(frozen=True, slots=True)
class BlockMean:
    """Mean of a block along x, y, z with its standard error.

    `by_chance` is half the width of the limits within which 95 % of such means less the first block's lie where nothing
    moves; zero for the first.
    """

    mean: Float[np.ndarray, "3"]
    standard_error: Float[np.ndarray, "3"]
    by_chance: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive cycles: their mean position (mm), how they are turned (degrees), and their RP_l."""

    first_cycle: int
    last_cycle: int
    position: BlockMean
    rp_mm: float
    turn: BlockMean | None = None


@dataclass(frozen=True, slots=True)
class PoseDrift:
    """One pose by cycle; `blocks` is empty where there are not two of them.

    `turns_deg` are rotation vectors from the first block's mean orientation, None without orientations; `hours` are
    times of capture after the session's first image, None where not all are known. `moved_by_chance_mm` and
    `turned_by_chance_deg` are the lengths below which chance alone leaves 95 % of the shifts.
    """

    pose_id: str
    cycles: Int[np.ndarray, " n"]
    positions_mm: Float[np.ndarray, "n 3"]
    blocks: tuple[Block, ...]
    turns_deg: Float[np.ndarray, "n 3"] | None = None
    hours: Float[np.ndarray, " n"] | None = None
    moved_by_chance_mm: float = 0.0
    turned_by_chance_deg: float = 0.0


def drift_svg(poses: Sequence[PoseDrift], title: str, block: int, about: str = "") -> bytes:
    """Return for every pose a panel each for x, y, z and the orientation, over time or over the cycles."""
    return draw_svg(
        lambda: drift_figure(poses, title, block),
        title,
        "\n".join(f"{p.pose_id}: {' '.join(_caption(p, block))}" for p in poses),
        about,
    )


def drift_figure(poses: Sequence[PoseDrift], title: str, block: int) -> Figure:
    """Draw it; within `drawing_style`."""
    columns = 1 if len(poses) == 1 else 2
    rows = math.ceil(len(poses) / columns)
    strips = 4 if any(pose.turns_deg is not None for pose in poses) else 3
    row = _CAPTION + strips * (_STRIP + _BETWEEN) - _BETWEEN + _BELOW
    width = _LEFT + columns * _PANEL_WIDTH + (columns - 1) * _GAP + 0.25
    figure = Figure((max(width, 6.6), _HEADER + row * rows + _FOOTER))
    title_at(figure, title, 12 if columns == 2 else 9.5)
    rasterized = sum(pose.positions_mm.size for pose in poses) > _MAX_VECTORS
    for place, pose in enumerate(poses):
        left = _LEFT + (place % columns) * (_PANEL_WIDTH + _GAP)
        top = _HEADER + (place // columns) * row
        text_at(figure, left, top + 0.1, short(pose.pose_id), fontsize=10, weight="bold")
        for line, text in enumerate(_caption(pose, block)):
            style = {"color": "#555555", "fontsize": 8} if line else {}
            text_at(figure, left, top + 0.31 + 0.19 * line, text, **style)
        own = 4 if pose.turns_deg is not None else 3
        panels = [
            axes_at(figure, left, top + _CAPTION + k * (_STRIP + _BETWEEN), _PANEL_WIDTH, _STRIP)
            for k in range(own)
        ]
        _draw(panels, pose, rasterized)
    figure.legend(
        handles=_legend(poses, block),
        loc="lower center",
        ncols=1 + columns,
        columnspacing=1.6,
        handletextpad=0.6,
    )
    return figure


def _caption(pose: PoseDrift, block: int) -> list[str]:
    n = len(pose.cycles)
    if not pose.blocks:
        return [f"n = {n}", f"no blocks: drift needs two of {block} cycles"]
    first, last = pose.blocks[0], pose.blocks[-1]
    shift, uncertainty = _shift(first.position, last.position)
    unit, factor = _unit(float(np.abs(shift).max() + uncertainty.max()))
    digits = _digits(float(uncertainty.max()) * factor)
    along = ", ".join(_signed(value * factor, digits) for value in shift)
    errors = ", ".join(f"{value * factor:.{digits}f}" for value in uncertainty)
    lines = [
        f"n = {n}   ·   RP_l {millimetres(first.rp_mm)} → {millimetres(last.rp_mm)} mm",
        f"moved {_length(shift, uncertainty, pose.moved_by_chance_mm, factor, unit)}",
    ]
    if first.turn is not None and last.turn is not None:
        turned = _length(*_shift(first.turn, last.turn), pose.turned_by_chance_deg, 1e3, "mdeg")
        lines.append(f"turned {turned}")
    return [*lines, f"x, y, z: {along} {unit} (standard errors {errors})"]


def _shift(first: BlockMean, last: BlockMean) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    return last.mean - first.mean, np.hypot(first.standard_error, last.standard_error)


def _length(
    shift: Float[np.ndarray, "3"],
    uncertainty: Float[np.ndarray, "3"],
    by_chance: float,
    factor: float,
    unit: str,
) -> str:
    """Return a length with its standard uncertainty, that along the shift, and what chance alone gives."""
    length = float(np.linalg.norm(shift))
    along = float(np.linalg.norm(shift * uncertainty)) / length if length > 0.0 else float(uncertainty.max())
    digits = _digits(along * factor)
    return (
        f"{length * factor:.{digits}f} ± {along * factor:.{digits}f} {unit} "
        f"(chance alone: up to {by_chance * factor:.{digits}f})"
    )


def _signed(value: float, digits: int) -> str:
    """Return a number with its sign; what rounds to zero has none."""
    text = f"{value:+.{digits}f}"
    return text[1:] if not text.strip("+-0.") else unsigned_zero(text)


def _draw(panels: Sequence[Axes], pose: PoseDrift, rasterized: bool) -> None:
    at, label = _course(pose)
    origin = pose.blocks[0].position.mean if pose.blocks else pose.positions_mm.mean(axis=0)
    offsets = pose.positions_mm - origin
    unit, factor = _unit(float(np.abs(offsets).max()))
    for axis, (name, colour, marker) in enumerate(_AXES):
        axes = panels[axis]
        means = [block.position for block in pose.blocks]
        _draw_course(axes, at, offsets[:, axis] * factor, colour, marker, rasterized)
        _draw_blocks(axes, pose, at, means, axis, origin[axis], factor, colour, rasterized)
        axes.set_ylabel(f"{name}, {unit}", labelpad=2)
    if len(panels) > 3 and pose.turns_deg is not None:
        turns = [block.turn for block in pose.blocks if block.turn is not None]
        widest = int(np.argmax(turns[-1].by_chance)) if turns else 0
        for axis, (_, colour, marker) in enumerate(_AXES):
            _draw_course(panels[3], at, 1e3 * pose.turns_deg[:, axis], colour, marker, rasterized)
            _draw_blocks(
                panels[3], pose, at, turns, axis, 0.0, 1e3, colour, rasterized, marker, axis == widest
            )
        panels[3].set_ylabel("turn, mdeg", labelpad=2)
        if not pose.turns_deg.any():
            panels[3].set_ylim(-1.0, 1.0)
    reach = max(max(np.abs(axes.get_ylim()).max() for axes in panels[:3]), 1e-9)
    margin = 0.03 * float(np.ptp(at)) or 1.0
    for place, axes in enumerate(panels):
        axes.axhline(0.0, color=INK, lw=0.7, zorder=1)
        axes.set_xlim(float(at.min()) - margin, float(at.max()) + margin)
        axes.yaxis.set_major_locator(MaxNLocator(3, symmetric=True))
        axes.xaxis.set_major_locator(MaxNLocator(8, integer=pose.hours is None))
        if place < 3:
            axes.set_ylim((-reach, reach) if offsets.any() else (-1.0, 1.0))
        if axes is not panels[-1]:
            axes.tick_params(labelbottom=False)
    panels[-1].set_xlabel(label)


def _course(pose: PoseDrift) -> tuple[Float[np.ndarray, " n"], str]:
    """Return where along the axis each cycle is, and the axis' label: time where it is known, else the cycle."""
    if pose.hours is None or not np.ptp(pose.hours) > 0.0:
        return pose.cycles.astype(np.float64), "cycle"
    unit, factor = ("h", 1.0) if np.ptp(pose.hours) >= 3.0 else ("min", 60.0)
    cycles = f"cycles {pose.cycles.min()} to {pose.cycles.max()}"
    return pose.hours * factor, f"time after the session's first image, {unit} ({cycles})"


def _draw_course(
    axes: Axes,
    at: Float[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    colour: str,
    marker: str,
    rasterized: bool,
) -> None:
    axes.plot(
        at,
        values,
        marker=marker,
        ms=2.8,
        mew=0,
        color=colour,
        alpha=0.55,
        ls="none",
        zorder=2,
        rasterized=rasterized,
    )


def _draw_blocks(
    axes: Axes,
    pose: PoseDrift,
    at: Float[np.ndarray, " n"],
    means: Sequence[BlockMean],
    axis: int,
    origin: float,
    factor: float,
    colour: str,
    rasterized: bool,
    marker: str = "",
    with_limits: bool = True,
) -> None:
    """Draw the blocks one after the other, with gaps (NaN) between; with the limits of chance where asked."""
    if not means:
        return
    x, middle, spread, limit = np.full((4, len(means), 3), np.nan)
    half = 0.4 * float(np.ptp(at)) / max(len(at) - 1, 1)
    for row, (block, mean) in enumerate(zip(pose.blocks, means, strict=True)):
        inside = at[(pose.cycles >= block.first_cycle) & (pose.cycles <= block.last_cycle)]
        x[row, :2] = float(inside.min()) - half, float(inside.max()) + half
        middle[row, :2] = (mean.mean[axis] - origin) * factor
        spread[row, :2] = 2.0 * mean.standard_error[axis] * factor
        limit[row, :2] = mean.by_chance[axis] * factor if row else np.nan
    x, middle, spread, limit = x.ravel(), middle.ravel(), spread.ravel(), limit.ravel()
    axes.fill_between(
        x, middle - spread, middle + spread, color=colour, alpha=0.18, lw=0, rasterized=rasterized
    )
    axes.plot(x, middle, color=colour, lw=1.7, marker=marker, ms=4.5, zorder=3, rasterized=rasterized)
    if with_limits:
        for side in (-1.0, 1.0):
            axes.plot(x, side * limit, **_CHANCE, zorder=2.5, rasterized=rasterized)


def _unit(reach_mm: float) -> tuple[str, float]:
    return ("mm", 1.0) if reach_mm >= 0.1 else ("µm", 1e3)


def _digits(uncertainty: float) -> int:
    """Return the decimals that show two digits of the uncertainty."""
    return 1 if uncertainty <= 0.0 else min(4, max(0, 1 - math.floor(math.log10(uncertainty))))


def _legend(poses: Sequence[PoseDrift], block: int) -> list[Any]:
    turned = any(pose.turns_deg is not None for pose in poses)
    handles: list[Any] = []
    for name, colour, marker in _AXES:
        label = f"{name}, about {name}: cycle, block mean" if turned else f"{name}: cycle, block mean"
        handles.append(Line2D([], [], marker=marker, color=colour, ms=4, mew=0, lw=1.7, label=label))
    return [
        *handles,
        Patch(fc="#bbbbbb", ec=FAINT, lw=0, label=f"± 2 standard errors of a block of {block}"),
        Line2D([], [], **_CHANCE, label="chance alone: 95 % of block means"),
    ]
