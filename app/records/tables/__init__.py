"""The tables: one schema for SQLite and PostgreSQL."""

from app.records.tables.access import AccessVersion, ApiKey, AuditEntry, Installation
from app.records.tables.base import SCOPES, STATUSES, Table, UtcDateTime, latest_ids
from app.records.tables.measurements import (
    MeasuredPose,
    Measurement,
    MeasurementChange,
    Removal,
    Result,
)
from app.records.tables.notices import Notice, NoticeMark, Webhook, WebhookDelivery
from app.records.tables.qualifications import Qualification
from app.records.tables.reports import Report, ReportForm, ReportSummary
from app.records.tables.sessions import (
    Pose,
    Robot,
    RobotEvent,
    Session,
    SessionTarget,
    Target,
    measured_target_fields,
    target_fields,
)

__all__ = [
    "SCOPES",
    "STATUSES",
    "AccessVersion",
    "ApiKey",
    "AuditEntry",
    "Installation",
    "MeasuredPose",
    "Measurement",
    "MeasurementChange",
    "Notice",
    "NoticeMark",
    "Pose",
    "Qualification",
    "Removal",
    "Report",
    "ReportForm",
    "ReportSummary",
    "Result",
    "Robot",
    "RobotEvent",
    "Session",
    "SessionTarget",
    "Table",
    "Target",
    "UtcDateTime",
    "Webhook",
    "WebhookDelivery",
    "latest_ids",
    "measured_target_fields",
    "target_fields",
]
