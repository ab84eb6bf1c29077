"""Draw the figures of docs/uncertainty.md: `python docs/figures/draw_uncertainty.py [--into docs/figures]`.

Cycles are simulated and assessed by the code as it is: stops of two images each, five poses before a mount that moves,
and robots of one known RP_l.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from core.metrology import (
    PoseCycles,
    PoseSeries,
    assess_repeatability,
    assess_steadiness,
    long_run_rp,
)

BLUE, ORANGE, GREY, RED = "#1f5fbf", "#d07a1e", "#9a9a9a", "#c03020"
ROBOT_MM, NOISE_MM, STOPS = 0.02, 0.006, 30
DRIFT_MM, POSES = 0.05, 5
ROBOTS = 60


def draw_all(into: Path) -> list[Path]:
    """Draw every figure, and return their paths."""
    return [draw(into) for draw in (draw_bursts, draw_steadiness, draw_intervals)]


def draw_bursts(into: Path) -> Path:
    """Draw thirty stops of two images each: what stops scatter, and what images scatter within them."""
    rng = np.random.default_rng(3)
    stops = rng.normal(0.0, ROBOT_MM, (STOPS, 1, 3))
    images = stops + rng.normal(0.0, NOISE_MM, (STOPS, 2, 3))
    means = images.mean(axis=1)
    within = (
        np.cov((images - means[:, None]).reshape(-1, 3).T, bias=True) * 2.0
    )  # one degree of freedom a stop
    (found,) = assess_repeatability([PoseCycles(means, None, np.tile(_six(within / 2.0), (STOPS, 1, 1)))])
    reading, floor = found.repeatability.position_mm, found.noise_floor.position_mm
    assert reading is not None
    assert floor is not None
    figure = Figure(figsize=(5.2, 4.6), layout="constrained")
    axes = figure.subplots()
    centre = 1e3 * means.mean(axis=0)
    for pair in images:
        axes.plot(*(1e3 * pair[:, :2]).T, "-o", color=BLUE, markersize=3, linewidth=1)
    _circle(axes, centre, 1e3 * reading, GREY, "--", f"RP_l read: {1e3 * reading:.0f} µm")
    _circle(axes, centre, 1e3 * floor, ORANGE, ":", f"floor by the pairs: {1e3 * floor:.0f} µm")
    axes.set_aspect("equal")
    axes.set_xlabel("x, µm")
    axes.set_ylabel("y, µm")
    axes.set_title("30 stops, two images each: a line joins the images of a stop", size=9)
    axes.legend(loc="upper right", fontsize=8)
    return _saved(figure, into, "uncertainty-bursts.png")


def draw_steadiness(into: Path) -> Path:
    """Draw the motion that five poses share, at rest and with a mount that moves, and what the test says."""
    rng = np.random.default_rng(5)
    figure = Figure(figsize=(7.6, 3.2), layout="constrained")
    for axes, length in zip(figure.subplots(1, 2, sharey=True), (0.0, DRIFT_MM), strict=True):
        cycles = np.arange(1, STOPS + 1)
        moved = np.linspace(0.0, length, STOPS)[:, None] * np.array([1.0, 0.0, 0.0])
        each = [moved + rng.normal(0.0, ROBOT_MM, (STOPS, 3)) for _ in range(POSES)]
        found = assess_steadiness([PoseSeries(one + 500.0 * k, cycles) for k, one in enumerate(each)])
        assert found.p_values is not None
        for one in each:
            shown = axes.plot(cycles, 1e3 * (one - one.mean(axis=0))[:, 0], ".", color=GREY, markersize=3)
        shown[0].set_label("a pose")
        common = np.mean([one - one.mean(axis=0) for one in each], axis=0)[:, 0]
        axes.plot(cycles, 1e3 * common, "-", color=BLUE, label="mean of the poses")
        verdict = "steady" if found.p_values.overall > 0.01 else "not steady"
        axes.set_title(
            f"mount moves by {1e3 * length:.0f} µm: p = {found.p_values.overall:.2g}, {verdict}", size=9
        )
        axes.set_xlabel("cycle")
        axes.legend(loc="upper left", fontsize=8)
        axes.set_ylabel("x about the pose's mean, µm" if axes.get_subplotspec().is_first_col() else "")
    return _saved(figure, into, "uncertainty-steadiness.png")


def draw_intervals(into: Path) -> Path:
    """Draw the 95 % intervals of RP_l of robots that are all equal, by 10 and by 30 cycles."""
    rng = np.random.default_rng(7)
    truth = ROBOT_MM * float(long_run_rp(np.ones((1, 3)))[0])
    figure = Figure(figsize=(7.6, 3.2), layout="constrained")
    for axes, n in zip(figure.subplots(1, 2, sharey=True), (10, 30), strict=True):
        found = assess_repeatability(
            [PoseCycles(rng.normal(0.0, ROBOT_MM, (n, 3)), None, np.zeros((n, 6, 6))) for _ in range(ROBOTS)]
        )
        readings = np.array([one.repeatability.position_mm for one in found], dtype=np.float64)
        bounds = np.array([one.interval.position_mm for one in found], dtype=np.float64)
        order = np.argsort(readings)
        holds = (bounds[:, 0] <= truth) & (truth <= bounds[:, 1])
        for place, k in enumerate(order):
            colour = BLUE if holds[k] else RED
            axes.plot([place, place], 1e3 * bounds[k], color=colour, linewidth=1 if holds[k] else 2.2)
            axes.plot(
                place,
                1e3 * readings[k],
                "." if holds[k] else "x",
                color=colour,
                markersize=3 if holds[k] else 5,
            )
        axes.axhline(1e3 * truth, color=ORANGE, linewidth=1.4, linestyle="--")
        axes.legend(handles=_intervals_legend(), loc="upper left", fontsize=8)
        axes.set_title(f"{n} cycles: {int(holds.sum())} of {ROBOTS} intervals hold the truth", size=9)
        axes.set_xlabel("equal robots, by what was read")
        axes.set_ylabel("RP_l, µm" if axes.get_subplotspec().is_first_col() else "")
    return _saved(figure, into, "uncertainty-intervals.png")


def _intervals_legend() -> list[Line2D]:
    return [
        Line2D([], [], color=ORANGE, linewidth=1.4, linestyle="--", label="figure of endless cycles"),
        Line2D([], [], color=BLUE, marker=".", label="read, 95 % interval"),
        Line2D([], [], color=RED, marker="x", linewidth=2.2, label="interval without the truth"),
    ]


def _six(covariance: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "6 6"]:
    found = np.zeros((6, 6))
    found[:3, :3] = covariance
    return found


def _circle(
    axes: Axes, centre: Float[np.ndarray, "3"], radius: float, colour: str, line: str, label: str
) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    x, y = centre[0] + radius * np.cos(turn), centre[1] + radius * np.sin(turn)
    axes.plot(x, y, line, color=colour, linewidth=1.8, label=label)


def _saved(figure: Figure, into: Path, name: str) -> Path:
    into.mkdir(parents=True, exist_ok=True)
    figure.savefig(into / name, dpi=110, metadata={"Software": None})
    return into / name


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--into", type=Path, default=Path(__file__).parent)
    for path in draw_all(parser.parse_args().into):
        print(path)
