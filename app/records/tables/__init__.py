"""The tables: one schema for SQLite and PostgreSQL."""

from app.records.tables.access import ApiKey, AuditEntry, Installation
from app.records.tables.base import (
    SCOPES,
    STATUSES,
    Bytes,
    JsonList,
    JsonObject,
    Table,
    UtcDateTime,
    latest_ids,
)
from app.records.tables.measurements import MeasuredPose, Measurement, Removal, Result
from app.records.tables.sessions import (
    Pose,
    Robot,
    Session,
    SessionTarget,
    Target,
    measured_target_fields,
    target_fields,
)

__all__ = [
    "SCOPES",
    "STATUSES",
    "ApiKey",
    "AuditEntry",
    "Bytes",
    "Installation",
    "JsonList",
    "JsonObject",
    "MeasuredPose",
    "Measurement",
    "Pose",
    "Removal",
    "Result",
    "Robot",
    "Session",
    "SessionTarget",
    "Table",
    "Target",
    "UtcDateTime",
    "latest_ids",
    "measured_target_fields",
    "target_fields",
]
