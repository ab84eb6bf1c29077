"""Plots of scatter: every cycle is in its frame, ellipses and units are right, captions say what is shown."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse
from matplotlib.text import Annotation

from app.reports.drift import drift_figure, drift_svg
from app.reports.scatter import PoseScatter, scatter_figure, scatter_svg
from app.reports.svg import drawing_style, millimetres
from tests.support.image.plotted import (
    NOTHING,
    ODD_SCATTERS,
    drifting,
    motionless,
    scatter,
)


def patches(figure: Figure, kind: type, colour: str | None = None) -> list[Any]:
    from matplotlib.colors import to_hex

    found = [patch for axes in figure.axes for patch in axes.patches if type(patch) is kind]
    return [p for p in found if colour is None or to_hex(p.get_edgecolor()) == colour]


def test_ellipses_are_three_standard_deviations_seen_along_each_axis() -> None:
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    covariance = turn @ np.diag([0.4, 0.1, 0.2]) ** 2 @ turn.T
    pose = scatter(sigma=0.2, observed_mm2=covariance, noise_mm2=np.diag([0.01, 0.02, 0.03]) ** 2)
    with drawing_style():
        figure = scatter_figure([pose], "title")
    observed, noise = patches(figure, Ellipse, "#0072b2"), patches(figure, Ellipse, "#d55e00")
    assert len(observed) == len(noise) == 3
    xy = observed[0]
    assert sorted([xy.width, xy.height]) == pytest.approx([0.6, 2.4])
    along = xy.angle if xy.width > xy.height else xy.angle + 90.0
    assert along % 180.0 == pytest.approx(np.degrees(np.arctan2(0.6, 0.8)))
    for ellipse, axes in zip(noise, ((0.01, 0.02), (0.01, 0.03), (0.02, 0.03)), strict=True):
        assert sorted([ellipse.width, ellipse.height]) == pytest.approx([6.0 * s for s in axes])
    assert [circle.radius for circle in patches(figure, Circle)] == pytest.approx([pose.rp_mm] * 3)


def points_in(figure: Figure, marker: str) -> list[list[int]]:
    """How many points of this marker each panel shows, inside its frame."""
    counts = []
    for axes in figure.axes:
        inside = 0
        for line in axes.lines:
            if line.get_marker() == marker:
                x, y = (np.asarray(values, dtype=float) for values in line.get_data())
                inside += int(np.sum((np.abs(x) <= axes.get_xlim()[1]) & (np.abs(y) <= axes.get_ylim()[1])))
        counts.append(inside)
    return [counts[i : i + 3] for i in range(0, len(counts), 3)]


def test_every_cycle_is_in_the_frame_and_what_is_beyond_is_pointed_at() -> None:
    poses = [pose for pose in ODD_SCATTERS if len(pose.positions_mm)]
    with drawing_style():
        figure = scatter_figure(poses, "title")
    assert points_in(figure, "o") == [[len(pose.positions_mm)] * 3 for pose in poses]
    place = [pose.pose_id for pose in poses].index("outliers")
    panels = figure.axes[3 * place : 3 * place + 3]
    assert points_in(figure, "x")[place] == [1, 1, 1]
    assert [len([t for t in axes.texts if isinstance(t, Annotation)]) for axes in panels] == [1, 1, 1]
    assert {axes.get_xlim() for axes in figure.axes} == {panels[0].get_xlim()}, "one scale for all poses"
    # The outlier 50 m away does not shrink what counts to a dot.
    with drawing_style():
        alone = scatter_figure([poses[place]], "title").axes[0]
    assert alone.get_xlim()[1] < 0.2 or "µm" in alone.get_xlabel()


def test_units_follow_the_scatter() -> None:
    poses = [scatter("a", sigma=1.0), scatter("b", sigma=1e-3), motionless()]
    quiet = [
        PoseScatter(
            p.pose_id, p.positions_mm, NOTHING, p.observed_mm2, None, p.rp_mm, None, None, None, "robot"
        )
        for p in poses
    ]
    with drawing_style():
        figures = [scatter_figure([one], "title") for one in quiet]
        together = scatter_figure(quiet, "title")
    assert [figure.axes[0].get_xlabel()[-2:] for figure in figures] == ["mm", "µm", "nm"]
    # Poses of one plot are compared: they have one scale.
    assert {axes.get_xlabel()[-2:] for axes in together.axes[::3]} == {"mm"}
    assert len({axes.get_xlim() for axes in together.axes}) == 1


def test_a_pose_has_a_panel_for_each_axis_and_one_for_its_orientation() -> None:
    with drawing_style():
        plain = drift_figure([drifting()], "title", 10)
        turned = drift_figure([drifting(turns=True, minutes=2.0)], "title", 10)
    assert [axes.get_ylabel().split(",")[0] for axes in turned.axes] == ["x", "y", "z", "turn"]
    assert len(plain.axes) == 3
    assert len({axes.get_ylim() for axes in plain.axes}) == 1, "one scale along x, y and z"
    assert (plain.axes[-1].get_xlabel(), turned.axes[-1].get_xlabel()) == (
        "cycle",
        "time after the session's first image, min (cycles 1 to 30)",
    )
    assert turned.axes[0].lines[0].get_xdata()[-1] == pytest.approx(60.0)
    # Two limits of what chance alone gives, about zero, from the second block on.
    dashed = [line for line in plain.axes[0].lines if line.get_linestyle() == "--"]
    limits = [np.asarray(line.get_ydata(), dtype=float) for line in dashed]
    assert len(limits) == 2
    assert np.isnan(limits[0][:3]).all()
    assert np.nansum(limits[0] + limits[1]) == 0.0
    assert np.nanmax(limits[1]) > 0.0


def test_captions_say_n_reading_interval_floor_and_verdict() -> None:
    pose = scatter(verdict="instrument_limited", outliers_mm=np.zeros((2, 3)))
    description = ElementTree.fromstring(scatter_svg([pose], "pooled")).findtext(
        "{http://www.w3.org/2000/svg}desc"
    )
    assert description is not None
    for part in (
        "P1: n = 14 (with 2 outliers)",
        "RP_l = 0.102 [0.0810, 0.138] mm",
        "noise floor 0.0131 mm",
        "corrected 0.0990 mm",
        "verdict: instrument limited",
    ):
        assert part in description
    assert [millimetres(v) for v in (0.0, 1e-5, 0.012345, 0.5, 12.345, 123456.0)] == [
        "0",
        "1e-05",
        "0.0123",
        "0.500",
        "12.3",
        "1.23e+05",
    ]


def test_ten_thousand_points_are_an_image_within_the_drawing() -> None:
    many = [drifting("P1", n=10_000, slope=1e-6)]
    drawn = drift_svg(many, "Drift", 10)
    assert drawn == drift_svg(many, "Drift", 10)
    assert len(drawn) < 1_000_000
    assert b"data:image/png;base64," in drawn
    assert b"data:image" not in drift_svg([drifting("P1", n=100)], "Drift", 10)


@pytest.mark.parametrize("frame", ["instrument's frame", "frame of the fixed camera"])
def test_a_title_fits_the_width(frame: str) -> None:
    title = f"Position scatter in the {frame}, about each pose's mean (estimator per_image_session_prior)"
    with drawing_style():
        figure = scatter_figure([scatter("a", sigma=1.0)], title)
        box = figure.texts[0].get_window_extent(FigureCanvasAgg(figure).get_renderer())
    assert figure.texts[0].get_text() == title
    assert box.x1 < figure.get_size_inches()[0] * figure.dpi
