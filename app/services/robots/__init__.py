"""Robots: their nominal parameters, what was done to them, and what the reports of their sessions say over time."""

from app.services.robots.events import NewEvent, add_event, delete_event, list_events
from app.services.robots.history import (
    HistoryRows,
    latest_reports,
    read_history_rows,
    reports_without_summary,
    save_summaries,
)
from app.services.robots.nominal import (
    create_robot,
    delete_robot,
    limits_setting,
    read_correction,
    read_plan,
    update_robot,
)

__all__ = [
    "HistoryRows",
    "NewEvent",
    "add_event",
    "create_robot",
    "delete_event",
    "delete_robot",
    "latest_reports",
    "limits_setting",
    "list_events",
    "read_correction",
    "read_history_rows",
    "read_plan",
    "reports_without_summary",
    "save_summaries",
    "update_robot",
]
