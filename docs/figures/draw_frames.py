"""Draw the figure of docs/kinematics.md: `python docs/figures/draw_frames.py [--into docs/figures]`.

The frames are those of the code: a nominal KUKA KR5 Arc at its home, by `core.kinematics.dh.frames`, with a camera on
its flange and a target in front of it; and one link by itself, with the four numbers that describe it.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from core.geometry import so3_exp, transform
from core.kinematics import Chain, frames
from core.simulation import KR5_ARC, KR5_ARC_HOME, T_FLANGE_CAMERA

AXIS_COLOURS = ("#c03020", "#2a8f3c", "#1f5fbf")
LINK, GREY, PURPLE = "#3c3c3c", "#a8a8a8", "#7a3fa0"
# Parallel projections: where x, y and z go, to the right and up.
OF_ROBOT = np.array([[0.78, 0.62, 0.0], [0.25, -0.31, 0.92]])
OF_LINK = np.array([[0.95, -0.35, 0.0], [0.2, 0.5, 0.85]])
LENGTH_MM = 170.0


@dataclass(frozen=True)
class Sheet:
    """Axes to draw on, and the projection they show."""

    axes: Axes
    view: Float[np.ndarray, "2 3"]

    def flat(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
        """Return points as they are drawn."""
        return np.asarray(points @ self.view.T)

    def line(self, points: Float[np.ndarray, "n 3"], style: str = "-", **options: Any) -> None:
        self.axes.plot(*self.flat(points).T, style, **options)

    def text(self, point: Float[np.ndarray, "3"], words: str, **options: Any) -> None:
        place = {"ha": "center", "va": "center", "size": 9, "color": LINK, **options}
        self.axes.text(*self.flat(point), words, **place)

    def frame(
        self,
        T: Float[np.ndarray, "4 4"],
        name: str,
        *,
        length: float = LENGTH_MM,
        which: str = "xyz",
        off: tuple[float, float] = (5, -12),
    ) -> None:
        """Draw a frame's axes, x red, y green, z blue, and its name next to the origin."""
        origin = self.flat(T[:3, 3])
        for k, colour in enumerate(AXIS_COLOURS):
            if "xyz"[k] not in which:
                continue
            end = self.flat(T[:3, 3] + length * T[:3, k])
            arrow = {"arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
            self.axes.annotate("", end, origin, arrowprops=arrow, zorder=4)
            label = origin + 1.14 * (end - origin)
            self.axes.plot(*label, alpha=0.0)  # so that the axes' limits take the arrow in
            self.axes.text(*label, "xyz"[k], color=colour, ha="center", va="center", size=8)
        self.axes.plot(*origin, "o", color=LINK, ms=3.5, zorder=5)
        self.axes.annotate(name, origin, off, textcoords="offset points", size=9, color=LINK, zorder=6)


def draw_robot(axes: Axes) -> None:
    """Draw the chain at home, camera and target."""
    sheet = Sheet(axes, OF_ROBOT)
    T = frames(KR5_ARC, KR5_ARC_HOME[None])[0]
    for before, after in pairwise(T):
        knee = before[:3, 3] + before[:3, 2] * (before[:3, 2] @ (after[:3, 3] - before[:3, 3]))
        corner = np.array([before[:3, 3], knee, after[:3, 3]])
        sheet.line(corner, color=GREY, lw=6, solid_capstyle="round", solid_joinstyle="round", zorder=1)
    sheet.frame(T[0], "base = frame 0")
    for i in (1, 2, 3):
        sheet.frame(T[i], f"frame {i}", which="xz")
    sheet.frame(T[4], "frames 4, 5", which="z", off=(6, 8))
    sheet.frame(T[5], "", which="xz")
    sheet.frame(T[6], "flange = frame 6", off=(-92, -12))
    camera = T[-1] @ T_FLANGE_CAMERA
    sheet.line(np.array([T[-1][:3, 3], camera[:3, 3]]), ":", color=LINK, lw=1)
    sheet.frame(camera, "camera", length=110.0, off=(10, 0))
    target = transform(so3_exp(np.array([math.pi, 0.0, 0.3])), np.array([1150.0, -150.0, -150.0]))
    corners = np.array([[0, 0, 0], [300, 0, 0], [300, 220, 0], [0, 220, 0], [0, 0, 0]], dtype=np.float64)
    sheet.line(corners @ target[:3, :3].T + target[:3, 3], color=GREY, lw=1)
    sheet.frame(target, "target", length=140.0)
    for start, end, words, bend in (
        (target, T[0], "T_target_base", -0.12),
        (T[0], T[-1], "T_base_flange(q)", 0.25),
        (target, camera, "T_target_camera", 0.25),
    ):
        a, b = sheet.flat(start[:3, 3]), sheet.flat(end[:3, 3])
        bow = {"arrowstyle": "-", "color": PURPLE, "lw": 1.0, "connectionstyle": f"arc3,rad={bend}"}
        axes.annotate("", b, a, arrowprops=bow, zorder=2)
        middle = (a + b) / 2 + bend / 2 * np.array([(b - a)[1], -(b - a)[0]])
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        axes.text(*middle, words, color=PURPLE, size=8, ha="center", va="center", bbox=box, zorder=3)
    axes.set_title("T_target_camera = T_target_base · T_base_flange(q) · T_flange_camera", size=10)


def draw_link(axes: Axes) -> None:
    """Draw joint i: its axis, the next one's, and what leads from one frame to the next."""
    sheet = Sheet(axes, OF_LINK)
    chain = Chain.from_rows([(420.0, -45.0, 300.0, 0.0)])
    first, last = frames(chain, np.radians([[35.0]]))[0]
    foot = first[:3, 3] + 300.0 * first[:3, 2]
    for frame, words in ((first, "axis of joint i"), (last, "axis of joint i + 1")):
        ends = frame[:3, 3] + np.outer([-150.0, 470.0], frame[:3, 2])
        sheet.line(ends, "-.", color=AXIS_COLOURS[2], lw=0.9)
        sheet.text(ends[1] + 25.0 * frame[:3, 2], words, color=AXIS_COLOURS[2], size=8)
    sheet.frame(first, "frame i-1", which="xz")
    sheet.frame(last, "frame i", which="xz")
    sheet.line(np.array([foot, last[:3, 3]]), color=LINK, lw=1.4)
    sheet.line(foot + np.outer([0.0, 210.0], first[:3, 0]), ":", color=AXIS_COLOURS[0], lw=1.2)
    turn = np.radians(np.linspace(0.0, 35.0, 20))[:, None]
    arc = foot + 150.0 * (np.cos(turn) * first[:3, 0] + np.sin(turn) * first[:3, 1])
    sheet.line(arc, color=LINK, lw=1)
    twist = np.radians(np.linspace(0.0, 45.0, 20))[:, None]
    across = np.cross(first[:3, 2], last[:3, 0])
    tilt = np.cos(twist) * first[:3, 2] + np.sin(twist) * across
    sheet.line(last[:3, 3] + np.outer([0.0, 260.0], first[:3, 2]), ":", color=AXIS_COLOURS[2], lw=1.2)
    sheet.line(last[:3, 3] + 210.0 * tilt, color=LINK, lw=1)
    sheet.text(first[:3, 3] + 215.0 * first[:3, 2] - 28.0 * first[:3, 0], "d", size=11)
    sheet.text((foot + last[:3, 3]) / 2.0 + 32.0 * first[:3, 2], "a", size=11)
    sheet.text(arc[9] + 95.0 * first[:3, 0], "θ + offset")
    sheet.text(last[:3, 3] + 245.0 * tilt[10], "α", size=11)
    axes.set_title("T = Rz(θ + offset) · Tz(d) · Tx(a) · Rx(α)", size=10)


def draw(into: Path) -> Path:
    """Write the figure and return its path."""
    figure = Figure(figsize=(11.0, 5.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
    draw_robot(left)
    draw_link(right)
    for axes in (left, right):
        axes.set_aspect("equal")
        axes.axis("off")
        axes.margins(0.06)
    into.mkdir(parents=True, exist_ok=True)
    path = into / "kinematics-frames.png"
    figure.savefig(path, dpi=100, metadata={"Software": None})
    return path


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--into", type=Path, default=Path(__file__).parent)
    print(draw(parser.parse_args().into))
