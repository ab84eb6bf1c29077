"""A schematic of an arm's axes and links, with the parameters that the poses cannot determine."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from app.reports.svg import BLUE, FAINT, INK, ORANGE, axes_at, draw_svg, text_at

_WIDTH, _HEADER, _DRAWING, _LINE, _FOOTER = 8.4, 0.8, 4.6, 0.19, 0.35
_LINE_LETTERS = 112
_AXIS_SHARE = 0.16
"""Length of a joint's axis to either side, of the arm's extent."""
_TAG_SHARE = 0.085
"""Height of a line of a tag, of the arm's extent."""
_LETTER_SHARE = 0.015
"""Width of a letter of a tag, of the arm's extent, where the arm is as wide as the sheet."""
_CIRCLE_SHARE = 0.06
"""Between the middle of an axis's number and a tag, of the arm's extent."""
_TURN = np.radians(35.0)
_RISE = np.radians(18.0)
"""The view: turned from the arm's plane, and from above."""


@dataclass(frozen=True, slots=True)
class JointAxis:
    """A joint's axis in the robot's base frame: a point of it (mm), and its direction."""

    joint: int
    origin_mm: Float[np.ndarray, "3"]
    direction: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True)
class LinkPart:
    """One length of a link, d along an axis or a along a common normal, from end to end in the base frame, mm."""

    name: str
    start_mm: Float[np.ndarray, "3"]
    end_mm: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True)
class UndeterminedGroup:
    """Parameters that cannot be determined separately: a letter, each with where it is (base frame, mm), and why."""

    letter: str
    places: tuple[tuple[str, Float[np.ndarray, "3"]], ...]
    sentence: str


def arm_schematic_svg(
    axes: Sequence[JointAxis],
    parts: Sequence[LinkPart],
    groups: Sequence[UndeterminedGroup],
    title: str,
    about: str = "",
) -> bytes:
    """Return the arm as it stood at one pose, seen from the side and above."""
    return draw_svg(
        lambda: arm_schematic_figure(axes, parts, groups, title), title, " ".join(_words(groups)), about
    )


def arm_schematic_figure(
    axes: Sequence[JointAxis], parts: Sequence[LinkPart], groups: Sequence[UndeterminedGroup], title: str
) -> Figure:
    """Draw it; within `drawing_style`."""
    lines = [line for words in _words(groups) for line in textwrap.wrap(words, _LINE_LETTERS)]
    figure = Figure((_WIDTH, _HEADER + _DRAWING + _FOOTER + _LINE * len(lines)))
    text_at(figure, 0.15, 0.32, title, fontsize=12, weight="bold")
    text_at(
        figure,
        0.15,
        0.58,
        "Dash-dotted: axes of the joints. Solid: lengths that the poses determine. Dashed, thick, with a letter: those "
        "they do not.",
        fontsize=8.5,
    )
    _draw(axes_at(figure, 0.15, _HEADER, _WIDTH - 0.3, _DRAWING), axes, parts, groups)
    for number, line in enumerate(lines):
        text_at(figure, 0.15, _HEADER + _DRAWING + 0.25 + _LINE * number, line, fontsize=8.5)
    return figure


def _words(groups: Sequence[UndeterminedGroup]) -> list[str]:
    """Return what stands below the drawing, which is what it says in words."""
    if not groups:
        return ["The poses determine every parameter."]
    return [f"{group.letter}  {group.sentence}" for group in groups]


def _draw(
    drawn: Axes, axes: Sequence[JointAxis], parts: Sequence[LinkPart], groups: Sequence[UndeterminedGroup]
) -> None:
    points = np.array([p for part in parts for p in (part.start_mm, part.end_mm)])
    view = _view(points)
    flat_points = points @ view.T
    low, high = flat_points.min(axis=0), flat_points.max(axis=0)
    extent = float(np.max(high - low))
    marked = {name for group in groups for name, _ in group.places}
    circles = []
    for axis in axes:
        ends = np.outer([-1.0, 1.0], axis.direction) * _AXIS_SHARE * extent + axis.origin_mm
        flat = ends @ view.T
        free = [float(np.linalg.norm(flat_points - end, axis=1).min()) for end in flat]
        drawn.plot(*flat.T, color=FAINT, linewidth=0.9, linestyle=(0, (9, 2.5, 1.5, 2.5)), zorder=1)
        across, up = flat[int(np.argmax(free))].tolist()
        circles.append(across)
        drawn.text(
            across,
            up,
            f"{axis.joint}",
            ha="center",
            va="center",
            fontsize=8.5,
            bbox={"boxstyle": "circle,pad=0.25", "facecolor": "white", "edgecolor": FAINT, "linewidth": 0.8},
            zorder=4,
        )
    for part in parts:
        flat = np.stack([part.start_mm, part.end_mm]) @ view.T
        if part.name in marked:
            drawn.plot(*flat.T, color=ORANGE, linewidth=4.0, linestyle=(0, (1.6, 0.9)), zorder=3)
        else:
            drawn.plot(*flat.T, color=BLUE, linewidth=2.2, zorder=2, solid_capstyle="round")
        drawn.plot(*flat.T, linestyle="none", marker="o", markersize=3.0, color=INK, zorder=3)
    _tags(drawn, view, (low, high), circles, groups)
    drawn.set_aspect("equal", adjustable="datalim")
    drawn.margins(0.12)
    drawn.axis("off")


def _tags(
    drawn: Axes,
    view: Float[np.ndarray, "2 3"],
    flat_ends: tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]],
    circles: Sequence[float],
    groups: Sequence[UndeterminedGroup],
) -> None:
    """Write every group's letter and parameters on either side of the arm and of the axes' numbers (`circles`, where
    they are across), with a line to where they are; those of one place share one tag.
    """
    extent = float(np.max(flat_ends[1] - flat_ends[0]))
    found: dict[tuple[int, int], tuple[np.ndarray, dict[str, list[str]]]] = {}
    for group in groups:
        for name, place in group.places:
            flat = view @ place
            key = (round(float(flat[0]) / (0.06 * extent)), round(float(flat[1]) / (0.06 * extent)))
            found.setdefault(key, (flat, {}))[1].setdefault(group.letter, []).append(name)
    if not found:
        return
    low, high = flat_ends
    middle = 0.5 * (low[0] + high[0])
    for side in (-1.0, 1.0):
        some = sorted(
            (one for one in found.values() if (one[0][0] >= middle) == (side > 0)), key=lambda one: -one[0][1]
        )
        if not some:
            continue
        gap = _TAG_SHARE * extent
        ends = [side * float((high if side > 0 else low)[0]) + 0.14 * extent]
        across = side * max([*ends, *(side * circle + _CIRCLE_SHARE * extent for circle in circles)])
        heights = np.array([float(flat[1]) for flat, _ in some])
        lines = [len(tags) for _, tags in some]
        for i in range(1, len(heights)):  # from the top, none over another: heights are those of middles
            heights[i] = min(heights[i], heights[i - 1] - 0.5 * gap * (lines[i - 1] + lines[i]))
        heights += max(0.0, low[1] - heights[-1])
        for (flat, tags), height in zip(some, heights.tolist(), strict=True):
            written = [f"{letter}: {', '.join(names)}" for letter, names in tags.items()]
            drawn.plot([flat[0], across], [flat[1], height], color=ORANGE, linewidth=1.0, zorder=3)
            reach = _LETTER_SHARE * extent * max(map(len, written))
            drawn.update_datalim([(across + side * reach, height)])
            drawn.text(
                across,
                height,
                "\n".join(written),
                ha="left" if side > 0 else "right",
                va="center",
                fontsize=8.5,
                color=INK,
                bbox={
                    "boxstyle": "round,pad=0.25",
                    "facecolor": "white",
                    "edgecolor": ORANGE,
                    "linewidth": 1.0,
                },
                zorder=5,
            )


def _view(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "2 3"]:
    """Return the drawing's directions in the base frame, across and up, turned from the plane that the arm is in."""
    level = points[:, :2] - points[0, :2]
    values, vectors = np.linalg.eigh(level.T @ level + 1e-9 * np.eye(2))
    ahead = vectors[:, int(np.argmax(values))]
    ahead = ahead * (1.0 if float(ahead @ level.sum(axis=0)) >= 0.0 else -1.0)
    lateral = np.array([-ahead[1], ahead[0]])
    across = np.cos(_TURN) * ahead + np.sin(_TURN) * lateral
    away = -np.sin(_TURN) * ahead + np.cos(_TURN) * lateral
    up = np.array([*(np.sin(_RISE) * away), np.cos(_RISE)])
    return np.stack([[*across, 0.0], up])
