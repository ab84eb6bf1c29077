"""Drawings of control charts: what was done to the robot is seen where the level changed, too."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import same_color

from app.reports.control_chart import ChartedFigure, control_chart_figure
from app.reports.svg import INK, RED


def test_an_event_is_seen_where_the_level_changed() -> None:
    values = np.array([0.05, 0.051, 0.049, 0.07, 0.071])
    chart = ChartedFigure(
        name="RP_l",
        unit="mm",
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
        events=(1, 3),
    )
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
