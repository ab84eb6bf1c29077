"""Draw figures of docs/uncertainty.md whose sessions are estimated: `python docs/figures/draw_statements.py`.

Grid points are simulated, and estimated and assessed by the code as it is: a robot at rest before noise of five kinds,
prints that depart from their grid, robots that miss commanded poses, and cycles that do not count.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

sys.path.insert(0, str(Path(__file__).parents[2]))

from benchmarks.trust.accuracy import Layout, simulate
from benchmarks.trust.bowed_sessions import DEPARTURES, Departure, Setup
from benchmarks.trust.bowed_sessions import simulate as simulate_print
from core.calibration import estimate_group
from core.metrology import PoseCycles, assess_distance
from core.session import assess_repeatability, estimate_session
from core.session.absolute_poses import absolute_poses
from core.targets import TargetSpec
from tests.support.simulation.correlated_noise import (
    DISTURBANCES,
    NoisySession,
    estimated,
    figures,
    gaussian_field,
    noisy_session,
    session_data,
    white,
)

BLUE, ORANGE, GREY, RED = "#1f5fbf", "#d07a1e", "#9a9a9a", "#c03020"
SMALL_BOARD = TargetSpec("chessboard", 9, 6, 30.0)
KINDS = ("white", "field of 2 squares", "field of 5 squares", "wave of .5 H", "wave of 2.5 H")
ROBOTS = 60
SLIP_MM, PATTERN_PX = 0.4, 0.05


def draw_all(into: Path) -> list[Path]:
    """Draw every figure, and return their paths."""
    return [draw(into) for draw in (draw_floor, draw_shape, draw_accuracy, draw_exclusion)]


def draw_floor(into: Path) -> Path:
    """Draw what a robot at rest reads over the floor stated for it, by the noise that is there and by white noise."""
    figure = Figure(figsize=(6.6, 3.4), layout="constrained")
    axes = figure.subplots()
    for place, kind in enumerate(KINDS):
        session = noisy_session(np.random.default_rng([4, place]), DISTURBANCES[kind])
        as_white = estimate_group(session.views, "pooled", intrinsics=session.camera)
        for found, colour, shift, label in (
            (as_white, GREY, -0.13, "floor as if noise were white"),
            (estimated(session), BLUE, 0.13, "floor by the noise that the repeats show"),
        ):
            rows = figures(session, found)
            ratio = [
                (row.repeatability.position_mm or np.nan) / (row.noise_floor.position_mm or np.nan)
                for row in rows
            ]
            at = np.full(len(ratio), place + shift)
            axes.plot(at, ratio, "o", color=colour, markersize=4, label=None if place else label)
    axes.axhline(1.0, color=ORANGE, linewidth=1.2, linestyle="--", label="floor = reading")
    axes.axhline(4.0, color=RED, linewidth=1.2, linestyle=":", label="from here on: verdict robot")
    axes.set_yscale("log")
    axes.set_yticks([0.5, 1, 2, 4, 8], ["0.5", "1", "2", "4", "8"])
    axes.set_yticks([], minor=True)
    axes.set_ylim(0.5, 20.0)
    axes.set_xticks(range(len(KINDS)), [kind.replace(" of ", "\nof ") for kind in KINDS], fontsize=8)
    axes.set_ylabel("RP_l read ÷ floor stated")
    axes.set_title("A robot at rest, five poses of 30 images: a dot each", size=9)
    axes.legend(fontsize=7, loc="upper left", ncols=2)
    return _saved(figure, into, "uncertainty-floor.png")


def draw_shape(into: Path) -> Path:
    """Draw the errors of ten distances with their 95 % intervals, before prints that depart from their grid."""
    figure = Figure(figsize=(7.6, 3.6), layout="constrained")
    departures = [one for one in DEPARTURES if one.stated is None]
    setups = (("five poses of one orientation", Setup()), ("and four tilted views", Setup(tilted_views=4)))
    for axes, (title, setup) in zip(figure.subplots(1, 2, sharey=True), setups, strict=True):
        for place, departure in enumerate(departures):
            errors, low, high = _distances(np.random.default_rng([6, place]), setup, departure)
            at = place + np.linspace(-0.32, 0.32, len(errors))
            held = (low <= 0.0) & (high >= 0.0)
            for one, colour in ((held, BLUE), (~held, RED)):
                axes.vlines(at[one], 1e3 * low[one], 1e3 * high[one], color=colour, linewidth=1.2)
                axes.plot(at[one], 1e3 * errors[one], ".", color=colour, markersize=4)
        axes.axhline(0.0, color=ORANGE, linewidth=1.2, linestyle="--")
        axes.set_xticks(
            range(len(departures)), [one.name.replace(" ", "\n", 1) for one in departures], fontsize=7
        )
        axes.set_title(title, size=9)
        axes.set_ylabel(
            "distance measured - true, µm" if axes.get_subplotspec().is_first_col() else "", fontsize=9
        )
    return _saved(figure, into, "uncertainty-shape.png")


def _distances(
    rng: np.random.Generator, setup: Setup, departure: Departure
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, " d"], Float[np.ndarray, " d"]]:
    """Return errors of the distances between the cube's poses, and the ends of their intervals, mm."""
    data, true = simulate_print(rng, setup, departure)
    estimate = estimate_session(data)
    absolute = absolute_poses(data, estimate).poses
    visits: dict[str, list[str]] = {}
    for pose in estimate.poses:
        visits.setdefault(pose.pose_id, []).append(pose.measurement_id)
    rows = []
    for i in range(1, 6):
        for j in range(1, i):
            ends = [f"P{j}", f"P{i}"]
            cycles = [
                PoseCycles(np.array([absolute[one].position_mm for one in visits[end]])) for end in ends
            ]
            length = float(np.linalg.norm(true[ends[1]] - true[ends[0]]))
            common = [absolute[visits[end][0]].common for end in ends]
            found = assess_distance(*cycles, np.zeros(3), np.array([length, 0.0, 0.0]), *common)
            assert found.accuracy_interval_mm is not None
            rows.append((found.performance.accuracy_mm or 0.0, *found.accuracy_interval_mm))
    errors, low, high = np.array(rows).T
    return errors, low, high


def draw_accuracy(into: Path) -> Path:
    """Draw what is reported of AP over what the robot was off: plain residual, studentised, and held out."""
    rng = np.random.default_rng(8)
    layout = Layout("five cube poses, one orientation", 5)
    rows = []
    for _ in range(ROBOTS):
        found, off, _ = simulate(rng, layout)
        for i in range(layout.count):
            one = found.poses[f"P{i + 1}"]
            assert one.parts is not None
            plain = float(np.linalg.norm(one.parts.residual))
            rows.append((np.linalg.norm(off[i]), plain, one.figures.position_mm, one.held_out.position_mm))
    true, *reported = np.array(rows, dtype=np.float64).T
    figure = Figure(figsize=(7.6, 3.0), layout="constrained")
    names = ("residual of the best fit", "studentised: what is stated", "held out")
    for axes, values, name, colour in zip(
        figure.subplots(1, 3, sharey=True), reported, names, (GREY, BLUE, ORANGE), strict=True
    ):
        ratio = float(np.sqrt(np.mean(values**2) / np.mean(true**2)))
        axes.plot(true, values, ".", color=colour, markersize=3)
        axes.plot([0.0, 1.2], [0.0, 1.2], color="black", linewidth=0.8, linestyle="--")
        axes.set_title(f"{name}\nrms reported ÷ true {ratio:.2f}", size=9)
        axes.set_xlabel("robot was off by, mm")
        axes.set_xlim(0.0, 1.2)
        axes.set_ylim(0.0, 2.2)
    figure.axes[0].set_ylabel("AP_p, mm")
    return _saved(figure, into, "uncertainty-accuracy.png")


def draw_exclusion(into: Path) -> Path:
    """Draw a slip on a sound image, which counts, and a cycle whose image is degraded, which does not."""
    figure = Figure(figsize=(7.6, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    slipped = noisy_session(
        np.random.default_rng(11),
        white(),
        poses=3,
        cycles=15,
        robot_mm=0.02,
        target=SMALL_BOARD,
        slip=(4, SLIP_MM),
    )
    _draw_cycles(left, slipped, f"a slip of {SLIP_MM} mm, image sound")
    still = noisy_session(
        np.random.default_rng(12), white(), poses=3, cycles=15, robot_mm=0.005, target=SMALL_BOARD
    )
    part = still.views.part(4)
    points = still.views.points_px.copy()
    points[part] += gaussian_field(3.0, PATTERN_PX)(np.random.default_rng(13), points[part], 90.0, 1)[0]
    degraded = dataclasses.replace(still, views=dataclasses.replace(still.views, points_px=points))
    _draw_cycles(right, degraded, f"an image with a pattern of {PATTERN_PX} px")
    return _saved(figure, into, "uncertainty-exclusion.png")


def _draw_cycles(axes: Axes, session: NoisySession, title: str) -> None:
    data = session_data(session)
    estimate = estimate_session(data)
    row = assess_repeatability(data, estimate).poses[0]
    places = {pose.measurement_id: pose for pose in estimate.poses if pose.pose_id == row.pose_id}
    out = {one.measurement_id for one in row.excluded}
    middle = np.median([pose.position_mm for pose in places.values()], axis=0)
    for name, pose in places.items():
        x, y = 1e3 * (pose.position_mm - middle)[:2]
        axes.plot(x, y, "x" if name in out else "o", color=RED if name in out else BLUE, markersize=5)
        assert pose.scatter is not None
        values, vectors = np.linalg.eigh(1e6 * pose.scatter[:2, :2])
        wide, tall = 2.0 * np.sqrt(values)
        turn = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
        axes.add_patch(
            Ellipse((x, y), wide, tall, angle=turn, fill=False, color=RED if name in out else GREY)
        )
    assert row.figures is not None
    said = "does not count" if out else "counts"
    reading = 1e3 * (row.figures.repeatability.position_mm or np.nan)
    axes.set_title(f"{title}: {said}.\nRP_l {reading:.0f} µm{_without(row.figures.without_outliers)}", size=8)
    axes.set_xlabel("x, µm")
    axes.set_ylabel("y, µm")
    axes.set_aspect("equal", adjustable="datalim")


def _without(without: object) -> str:
    alone = getattr(without, "position_mm", None)
    return "" if alone is None else f" over all cycles; {1e3 * alone:.0f} µm without it"


def _saved(figure: Figure, into: Path, name: str) -> Path:
    into.mkdir(parents=True, exist_ok=True)
    figure.savefig(into / name, dpi=110, metadata={"Software": None})
    return into / name


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--into", type=Path, default=Path(__file__).parent)
    for path in draw_all(parser.parse_args(arguments).into):
        print(path)


if __name__ == "__main__":
    main()
