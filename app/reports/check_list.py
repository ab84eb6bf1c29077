"""Check list of a test by ISO 9283: what to set, which poses to visit in which order, boxes to tick, lines to sign."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure

_A4_INCH = (8.27, 11.69)
_LEFT, _RIGHT, _TOP = 0.08, 0.94, 0.95
_LINE = 0.0165
_CYCLES_A_ROW = 10
_STATED = (
    "robot, serial number",
    "load, its centre of gravity",
    "speed (the standard: 100 %)",
    "temperature at the start, at the end",
    "warm-up",
    "camera, lens, its setting locked",
    "target, fixed where",
    "operator, date",
)
_BEFORE = (
    "The robot has warmed up, as its maker asks, and carries the stated load.",
    "Automatic focus, zoom, exposure and image stabilisation are off; the lens is locked.",
    "The target is flat and fixed: nothing but the robot moves.",
    "Every pose is approached as commanded, from the same side in all cycles.",
    "The image is taken when the robot has settled.",
)


def draw_check_list(plan: Mapping[str, Any]) -> bytes:
    """Return the check list of a plan (`gridpose robots plan iso9283`) as a PDF of one page."""
    figure = Figure(figsize=_A4_INCH)
    FigureCanvasPdf(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.0)
    y = _title(axes, plan)
    y = _lines(axes, y, "Stated before the test", _STATED)
    y = _boxes(axes, y, "Before the first cycle", _BEFORE)
    y = _conditions(axes, y, plan)
    y = _poses(axes, y, plan)
    y = _boxes(
        axes,
        y,
        "Once, before the cycles: views that determine the lens; send them without a cycle number",
        [f"{pose['pose_id']}   {_place(pose)}" for pose in plan["additional_poses"]],
    )
    _cycles(axes, y, plan)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="pdf", metadata={"CreationDate": None, "Title": "ISO 9283 check list"})
    return buffer.getvalue()


def _title(axes: Axes, plan: Mapping[str, Any]) -> float:
    cube = plan["cube"]
    axes.text(_LEFT, _TOP, f"Pose accuracy and repeatability, {plan['standard']}", size=14, weight="bold")
    centre = ", ".join(f"{value:g}" for value in cube["centre_mm"])
    axes.text(
        _LEFT,
        _TOP - 1.4 * _LINE,
        f"Test cube of {cube['side_mm']:g} mm at ({centre}) mm, plane {cube['plane']}; {plan['cycles']} cycles, "
        f"{plan['images_per_stop']} {'image' if plan['images_per_stop'] == 1 else 'images'} a stop, "
        f"{plan['images']} images",
        size=9,
    )
    return _TOP - 3.5 * _LINE


def _heading(axes: Axes, y: float, text: str) -> float:
    axes.text(_LEFT, y, text, size=10, weight="bold")
    return y - 1.3 * _LINE


def _lines(axes: Axes, y: float, heading: str, names: Sequence[str]) -> float:
    y = _heading(axes, y, heading)
    for name in names:
        axes.text(_LEFT, y, name, size=8.5)
        axes.plot([0.42, _RIGHT], [y - 0.003, y - 0.003], color="0.6", linewidth=0.5)
        y -= 1.25 * _LINE
    return y - 0.5 * _LINE


def _boxes(axes: Axes, y: float, heading: str, texts: Sequence[str]) -> float:
    y = _heading(axes, y, heading)
    for text in texts:
        _box(axes, _LEFT, y)
        axes.text(_LEFT + 0.022, y, text, size=8.5)
        y -= 1.15 * _LINE
    return y - 0.5 * _LINE


def _box(axes: Axes, x: float, y: float) -> None:
    width, height = 0.0115, 0.0115 * _A4_INCH[0] / _A4_INCH[1]
    axes.plot([x, x + width, x + width, x, x], [y, y, y + height, y + height, y], color="0.3", linewidth=0.6)


def _poses(axes: Axes, y: float, plan: Mapping[str, Any]) -> float:
    order = ", ".join(plan["order_of_a_cycle"])
    y = _heading(axes, y, f"Test poses; start at P1, then in every cycle {order}")
    for pose in plan["poses"]:
        axes.text(_LEFT, y, f"{pose['pose_id']}   {_place(pose)}", size=8.5)
        y -= 1.1 * _LINE
    return y - 0.5 * _LINE


def _conditions(axes: Axes, y: float, plan: Mapping[str, Any]) -> float:
    """Write loads, speeds, warm-up and directions of approach, where they are planned."""
    lines = []
    if plan["warm_up_min"] is not None:
        lines.append(f"Warm-up: {plan['warm_up_min']:g} min")
    stated = []
    for run in plan["runs"]:
        load = "" if run["load_kg"] is None else f"load {run['load_kg']:g} kg"
        speed = "" if run["speed_percent"] is None else f"speed {run['speed_percent']:g} %"
        if load or speed:
            stated.append(f"run {run['run']}: {', '.join(filter(None, (load, speed)))}")
    lines += [f"A session each: {'; '.join(part)}" for part in _chunks(stated)]
    ways = [
        f"{pose['pose_id']} ({', '.join(f'{value:g}' for value in pose['approach_from_mm'])})"
        for pose in plan["approach_poses"]
    ]
    lines += [f"Approached from: {'; '.join(part)}" for part in _chunks(ways)]
    return _boxes(axes, y, "Runs and approaches", lines) if lines else y


def _chunks(texts: Sequence[str]) -> list[Sequence[str]]:
    """Return three texts a line."""
    return [texts[i : i + 3] for i in range(0, len(texts), 3)]


def _place(pose: Mapping[str, Any]) -> str:
    x, y, z = (f"{value:.3f}" for value in pose["position_mm"])
    angles = ", ".join(f"{pose[name]:.3f}°" for name in ("roll_deg", "pitch_deg", "yaw_deg"))
    return f"x {x}, y {y}, z {z} mm; roll, pitch, yaw {angles}"


def _cycles(axes: Axes, y: float, plan: Mapping[str, Any]) -> None:
    y = _heading(axes, y, "Cycles done")
    for cycle in range(plan["cycles"]):
        row, column = divmod(cycle, _CYCLES_A_ROW)
        x, at = _LEFT + column * (_RIGHT - _LEFT) / _CYCLES_A_ROW, y - row * 1.15 * _LINE
        if at < 0.06:  # the foot of the page
            axes.text(_LEFT, at, f"and up to cycle {plan['cycles']}", size=8.5)
            break
        _box(axes, x, at)
        axes.text(x + 0.02, at, str(cycle + 1), size=8)
    axes.plot([0.55, _RIGHT], [0.04, 0.04], color="0.3", linewidth=0.6)
    axes.text(0.55, 0.026, "signature", size=8)
