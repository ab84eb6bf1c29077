"""Scatter of each pose's cycles about their mean, with the scatter of the instrument alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Ellipse, Patch
from matplotlib.ticker import MaxNLocator

from app.reports.svg import (
    BLUE,
    FAINT,
    INK,
    ORANGE,
    RED,
    axes_at,
    draw_svg,
    millimetres,
    short,
    text_at,
    title_at,
)

_PLANES = ((0, 1), (0, 2), (1, 2))
_LEFT, _PANEL, _GAP = 0.75, 2.45, 0.75
_HEADER, _CAPTION, _BELOW, _FOOTER = 0.62, 0.5, 0.62, 0.62
_LEAST_HALF_MM = 1e-6  # the half width shown of a pose without any scatter


@dataclass(frozen=True, slots=True)
class PoseScatter:
    """One pose: positions of its cycles, outliers apart, and the results.

    `observed_mm2` is the cycles' covariance, `noise_mm2` the mean of what each measurement states of its own noise;
    None where there are fewer than two cycles, or nothing is known of the instrument. The figures are those of the
    repeatability analysis. `note` says why nothing counts, where nothing does.
    """

    pose_id: str
    positions_mm: Float[np.ndarray, "n 3"]
    outliers_mm: Float[np.ndarray, "m 3"]
    observed_mm2: Float[np.ndarray, "3 3"] | None
    noise_mm2: Float[np.ndarray, "3 3"] | None
    rp_mm: float | None
    interval_mm: tuple[float, float] | None
    floor_mm: float | None
    corrected_mm: float | None
    verdict: str
    note: str = ""


def scatter_svg(
    poses: Sequence[PoseScatter], title: str, about: str = "", *, half_width_mm: float | None = None
) -> bytes:
    """Return three projections of every pose, one pose a row, all on one scale: their own where none is given."""
    return draw_svg(
        lambda: scatter_figure(poses, title, half_width_mm),
        title,
        "\n".join(f"{p.pose_id}: {_caption(p)}" for p in poses),
        about,
    )


def scatter_figure(poses: Sequence[PoseScatter], title: str, half_width_mm: float | None = None) -> Figure:
    """Draw it; within `drawing_style`."""
    rows = [_CAPTION + (_PANEL + _BELOW if len(pose.positions_mm) else 0.1) for pose in poses]
    width = _LEFT + 3 * _PANEL + 2 * _GAP + 0.25
    figure = Figure((width, _HEADER + sum(rows) + _FOOTER))
    title_at(figure, title)
    tops = accumulate(rows, initial=_HEADER)
    half = common_half_width(poses) if half_width_mm is None else half_width_mm
    for top, pose in zip(tops, poses, strict=False):
        text_at(figure, 0.15, top + 0.1, short(pose.pose_id), fontsize=11, weight="bold")
        text_at(figure, 0.15, top + 0.33, _caption(pose))
        if not len(pose.positions_mm):
            continue
        mean = pose.positions_mm.mean(axis=0)
        unit, factor = ("mm", 1.0) if half >= 0.1 else ("µm", 1e3) if half >= 1e-4 else ("nm", 1e6)
        for column, plane in enumerate(_PLANES):
            axes = axes_at(figure, _LEFT + column * (_PANEL + _GAP), top + _CAPTION, _PANEL, _PANEL)
            _project(axes, pose, mean, plane, half, factor)
            axes.set_xlabel(f"{'xyz'[plane[0]]} − mean, {unit}")
            axes.set_ylabel(f"{'xyz'[plane[1]]} − mean, {unit}", labelpad=2)
    figure.legend(handles=_legend(), loc="lower center", ncols=5, columnspacing=1.6, handletextpad=0.6)
    return figure


def _caption(pose: PoseScatter) -> str:
    n, outliers = len(pose.positions_mm) + len(pose.outliers_mm), len(pose.outliers_mm)
    named = "1 outlier" if outliers == 1 else f"{outliers} outliers"
    parts = [f"n = {n}" + (f" (with {named})" if outliers else "")]
    if pose.note:
        parts.append(pose.note)
    elif pose.rp_mm is None:
        parts.append("repeatability needs two cycles")
    else:
        within = (
            f" [{millimetres(pose.interval_mm[0])}, {millimetres(pose.interval_mm[1])}]"
            if pose.interval_mm
            else ""
        )
        parts.append(f"RP_l = {millimetres(pose.rp_mm)}{within} mm")
        if pose.floor_mm is not None:
            parts.append(f"noise floor {millimetres(pose.floor_mm)} mm")
        if pose.corrected_mm is not None:
            parts.append(f"corrected {millimetres(pose.corrected_mm)} mm")
        parts.append(f"verdict: {pose.verdict.replace('_', ' ')}")
    return "   ·   ".join(parts)


def common_half_width(poses: Sequence[PoseScatter]) -> float:
    """Return the one scale of all poses, half the width in mm; a pose of one cycle has no scatter to give it."""
    reaches = [(len(one.positions_mm) > 1, one) for one in poses if len(one.positions_mm)]
    several = [one for is_scattered, one in reaches if is_scattered] or [one for _, one in reaches]
    return max((_half_width(one, one.positions_mm.mean(axis=0)) for one in several), default=_LEAST_HALF_MM)


def _half_width(pose: PoseScatter, mean: Float[np.ndarray, "3"]) -> float:
    """Return the half width (mm) that shows all cycles but outliers, at which arrows point."""
    reaches = [float(np.abs(pose.positions_mm - mean).max())]
    shown = [pose.noise_mm2]
    if not len(pose.outliers_mm):  # otherwise these are the outliers' size
        reaches.append(pose.rp_mm or 0.0)
        shown.append(pose.observed_mm2)
    for covariance in shown:
        if covariance is not None:
            reaches.append(3.0 * math.sqrt(max(float(np.diag(covariance).max()), 0.0)))
    return max(1.08 * max(reaches), _LEAST_HALF_MM)


def _project(
    axes: Axes,
    pose: PoseScatter,
    mean: Float[np.ndarray, "3"],
    plane: tuple[int, int],
    half: float,
    factor: float,
) -> None:
    reach = half * factor
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(5, symmetric=True, min_n_ticks=3))
    where = list(plane)
    if pose.rp_mm is not None and pose.rp_mm > 0.0:
        axes.add_patch(Circle((0, 0), pose.rp_mm * factor, **_SPHERE))
    for covariance, style in ((pose.observed_mm2, _OBSERVED), (pose.noise_mm2, _NOISE)):
        if covariance is not None:
            axes.add_patch(_ellipse(covariance[np.ix_(where, where)] * factor**2, style))
    counted = (pose.positions_mm - mean)[:, where] * factor
    axes.plot(counted[:, 0], counted[:, 1], **_CYCLE)
    for place in (pose.outliers_mm - mean)[:, where] * factor:
        far = float(np.abs(place).max()) / reach
        if far <= 1.0:
            axes.plot(*place, **_OUTLIER)
            continue
        # Beyond the frame: an arrow at its edge shows the way.
        tip = 0.97 * place / far
        axes.annotate(
            "", tip, 0.82 * tip / 0.97, arrowprops={"arrowstyle": "-|>", "color": RED, "lw": 1.3}, zorder=5
        )
    axes.plot(0, 0, marker="+", color=INK, ms=7, mew=1.0, ls="none", zorder=6)


def _ellipse(covariance: Float[np.ndarray, "2 2"], style: dict[str, Any]) -> Ellipse:
    """Return the outline of the ellipsoid of 3 standard deviations, seen along the third axis."""
    values, vectors = np.linalg.eigh(covariance)
    width, height = 6.0 * np.sqrt(np.maximum(values, 0.0))
    angle = math.degrees(math.atan2(vectors[1, 0], vectors[0, 0]))
    return Ellipse((0.0, 0.0), float(width), float(height), angle=angle, **style)


_OBSERVED: dict[str, Any] = {"fc": (*(0.0, 0.447, 0.698), 0.13), "ec": BLUE, "lw": 1.4, "zorder": 2}
_NOISE: dict[str, Any] = {
    "fc": (0.835, 0.369, 0.0, 0.28),
    "ec": ORANGE,
    "lw": 1.4,
    "ls": (0, (1, 1)),
    "zorder": 3,
}
_SPHERE: dict[str, Any] = {"fill": False, "ec": FAINT, "lw": 1.0, "ls": (0, (4, 3)), "zorder": 1.5}
_CYCLE: dict[str, Any] = {"marker": "o", "color": INK, "ms": 3.2, "mew": 0, "ls": "none", "zorder": 4}
_OUTLIER: dict[str, Any] = {"marker": "x", "color": RED, "ms": 5.5, "mew": 1.4, "ls": "none", "zorder": 5}


def _legend() -> list[Any]:
    return [
        Line2D([], [], **_CYCLE, label="one cycle"),
        Line2D([], [], **_OUTLIER, label="outlier (arrow: beyond the frame)"),
        Patch(fc=_OBSERVED["fc"], ec=BLUE, label="observed, 3 S"),
        Patch(fc=_NOISE["fc"], ec=ORANGE, ls=_NOISE["ls"], label="instrument's noise, 3 σ"),
        Line2D([], [], color=FAINT, lw=1.0, ls=(0, (4, 3)), label="RP_l"),
    ]
