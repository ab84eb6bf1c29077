"""A robot over its sessions, and two sessions compared: from the figures of stored reports, which are signed.

`summary_of` takes from a report's JSON form what is compared; it is stored with the report, so that a history of a
thousand sessions reads no form. `history_document` and `comparison_document` are what routes and commands show.
"""

from app.analyses.history.charting import HistoryEvent, charts_of, series_of
from app.analyses.history.comparison import comparison_document, conclusion
from app.analyses.history.drawing import MAX_CHARTS, ChartAxis, charts_of_tests, draw_charts
from app.analyses.history.latest import LatestFigures
from app.analyses.history.likeness import group_comparable, not_stated, unlike
from app.analyses.history.over_time import charted_tests, entries_of_qualifications, history_document
from app.analyses.history.reading import (
    KINDS,
    read_filed_report,
    read_history,
    summarise_reports,
    summary_or_none,
)
from app.analyses.history.summaries import NotAReport, Summary, read_report, read_summary, summary_of

__all__ = [
    "KINDS",
    "MAX_CHARTS",
    "ChartAxis",
    "HistoryEvent",
    "LatestFigures",
    "NotAReport",
    "Summary",
    "charted_tests",
    "charts_of",
    "charts_of_tests",
    "comparison_document",
    "conclusion",
    "draw_charts",
    "entries_of_qualifications",
    "group_comparable",
    "history_document",
    "not_stated",
    "read_filed_report",
    "read_history",
    "read_report",
    "read_summary",
    "series_of",
    "summarise_reports",
    "summary_of",
    "summary_or_none",
    "unlike",
]
