"""Drawings of control charts: what was done to the robot is seen where the level changed, too."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import same_color

from app.reports.control_chart import ChartedFigure, control_chart_figure
from app.reports.svg import INK, RED, drawing_style


def charted(by_date: bool, places: np.ndarray, events: tuple[float, ...]) -> ChartedFigure:
    values = np.array([0.05, 0.051, 0.049, 0.07, 0.071])
    return ChartedFigure(
        name="RP_l",
        unit="mm",
        by_date=by_date,
        places=places,
        values=values,
        centre=0.05,
        lower=0.04,
        upper=0.06,
        outside=(3, 4),
        ewma=np.zeros(5),
        ewma_limit=1.0,
        since=3,
        at=4,
        sentence="RP_l went up.",
        events=events,
    )


def test_an_event_is_seen_where_the_level_changed() -> None:
    chart = charted(False, np.arange(1.0, 6.0), (1.5, 3.5))
    for axes in control_chart_figure([chart], "history").axes[:2]:
        upright = [
            line for line in axes.lines if len(set(line.get_xdata())) == 1 and len(line.get_xdata()) == 2
        ]
        at_change = [line for line in upright if line.get_xdata()[0] == 3.5]
        (changed,) = [line for line in at_change if same_color(line.get_color(), RED)]
        (event,) = [line for line in at_change if same_color(line.get_color(), INK)]
        assert event.get_zorder() > changed.get_zorder(), "the event is drawn above"
        assert event.get_linewidth() < changed.get_linewidth(), "and the change is seen at its sides"
        marks = [line for line in axes.lines if line.get_marker() == "v"]
        assert sorted(line.get_xdata()[0] for line in marks) == [1.5, 3.5]


def test_a_constant_figure_has_no_axis_of_rounding_errors() -> None:
    """Its limits are off by adding logarithms."""
    value = 1234.567
    chart = dataclasses.replace(
        charted(False, np.arange(1.0, 6.0), ()),
        values=np.full(5, value),
        centre=value * (1.0 - 7e-15),
        lower=value * (1.0 - 7e-15),
        upper=value * (1.0 - 7e-15),
    )
    with drawing_style():
        figure = control_chart_figure([chart], "history")
        FigureCanvasAgg(figure).draw()
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert len(set(labels)) == len(labels) >= 3
    assert max(map(len, labels)) <= 7


def test_dates_are_few_legible_and_where_they_belong() -> None:
    """Weeks apart, minutes apart, and a year between two: no tick's text runs into the next."""
    day = 20_800.0  # of 2026
    for steps in ([0.0, 7.0, 14.0, 21.0, 28.0], [0.0, 0.01, 0.02, 0.03, 0.05], [0.0, 1.0, 2.0, 3.0, 400.0]):
        places = day + np.array(steps)
        event = float(places[2] + 0.4 * (places[3] - places[2]))
        with drawing_style():
            figure = control_chart_figure([charted(True, places, (event,))], "history")
            canvas = FigureCanvasAgg(figure)
            canvas.draw()
        above, below = figure.axes[:2]
        np.testing.assert_allclose(above.lines[3].get_xdata(), places)
        shown = [label for label in below.get_xticklabels() if label.get_text()]
        assert 3 <= len(shown) <= 9
        boxes = sorted(
            (label.get_window_extent(canvas.get_renderer()) for label in shown), key=lambda box: box.x0
        )
        assert all(one.x1 < other.x0 for one, other in itertools.pairwise(boxes))
        (mark,) = [line for line in above.lines if line.get_marker() == "v"]
        assert mark.get_xdata()[0] == event
        assert below.get_xlabel() == "measured, UTC"
