"""Control charts of a figure over sessions: individuals, moving range, and an EWMA with a stated false-alarm rate."""

from core.metrology.control_chart.chart import MIN_POINTS, ControlChart, chart_figure
from core.metrology.control_chart.run_length import ewma_limit, ewma_run_length
from core.metrology.control_chart.self_starting import self_starting_scores

__all__ = [
    "MIN_POINTS",
    "ControlChart",
    "chart_figure",
    "ewma_limit",
    "ewma_run_length",
    "self_starting_scores",
]
