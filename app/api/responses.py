"""Rows as the API's documents, and files as answers, always whole."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterable
from io import FileIO
from typing import Any, TypeVar

from fastapi.responses import FileResponse
from pydantic import BaseModel, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.types import Receive, Scope, Send

from app.api.schemas.common import AdvisoryRead
from app.api.schemas.measurements import MeasurementRead
from app.api.schemas.poses import PoseRead
from app.api.schemas.sessions import SessionRead
from app.errors import RowUnreadable
from app.records.ids import moment_of
from app.records.numbers import rounded
from app.records.readable import unreadable_columns
from app.records.tables import Measurement, Pose
from app.services.measurements import MeasurementDetail, NewMeasurement
from app.services.sessions import SessionDetail

_ENCODER = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"))
_FIELDS = tuple(MeasurementRead.model_fields)
_PLAIN_FIGURES = (
    "edge_width_px",
    "motion_blur_px",
    "saturated_fraction",
    "clipped_fraction",
    "contrast",
    "coverage_fraction",
)
_RETRY = (
    "Retry the measurement, which computes it again from the original. Where that does not help, restore the database "
    "from a backup."
)
_BLANK = {
    "pose_id": "",
    "focus_group": "",
    "sha256": "",
    "bytes": 0,
    "attempts": 0,
}
"""What stands for an unreadable value that the document must have; its failure names the column."""
Row = TypeVar("Row")
Document = TypeVar("Document", bound=BaseModel)


def stored_document(kind: type[Document], row: Any, noun: str) -> Document:
    """Return a stored row as a document; RowUnreadable where the row does not hold what the document needs."""
    try:
        return kind.model_validate(row)
    except ValidationError as error:
        columns = sorted({str(each["loc"][0]) for each in error.errors() if each["loc"]})
        raise RowUnreadable(noun, columns) from error


def stored_documents(
    document: Callable[[Row], Document], rows: Iterable[Row], id_of: Callable[[Row], str]
) -> tuple[list[Document], list[AdvisoryRead]]:
    """Return the documents of a page's rows, and a warning for each row that cannot be read."""
    items: list[Document] = []
    warnings: list[AdvisoryRead] = []
    for row in rows:
        try:
            items.append(document(row))
        except RowUnreadable as error:
            warnings.append(
                AdvisoryRead(code=error.code, detail=f"{id_of(row)}: {error.detail}", advice=error.advice)
            )
    return items, warnings


def session_document(view: SessionDetail) -> SessionRead:
    """Return a session with its counts."""
    session = view.session
    return stored_document(
        SessionRead,
        {
            "id": session.id,
            "name": session.name,
            "target_ids": [target.target_id for target in session.targets],
            "robot_id": session.robot_id,
            "lens": session.lens,
            "intrinsics": session.intrinsics,
            "conditions": session.conditions,
            "camera_mount": session.camera_mount,
            "created_at": session.created_at,
            "counts": view.counts,
        },
        "session",
    )


def pose_document(pose: Pose) -> PoseRead:
    """Return a pose."""
    return stored_document(PoseRead, pose, "pose")


def measurement_document(
    view: MeasurementDetail, points: list[dict[str, Any]] | None = None
) -> MeasurementRead:
    """Return a measurement with its calibration or failure, and with `points` where they were asked for.

    One that cannot be read is shown as failed, with what can be read of it.
    """
    damaged = unreadable_columns(view.measurement)
    if not damaged:
        try:
            return _readable_document(view, points)
        except RowUnreadable as error:
            return _unreadable_document(view, error)
    return _unreadable_document(view, RowUnreadable("measurement", damaged, _RETRY))


def new_measurement_json(new: NewMeasurement) -> bytes:
    """Return the document of a measurement that was just made: what `measurement_document` returns of its row, as JSON.

    Nothing is computed of it yet, and its values were checked when they came.
    """
    row = new.row
    values = {name: row.get(name) for name in _FIELDS}
    values["burst"] = row["burst"] or 1
    values["siblings"] = new.siblings
    for name in ("captured_at", "received_at"):
        moment = row[name]
        values[name] = moment.isoformat().replace("+00:00", "Z") if moment is not None else None
    return _ENCODER.encode(values).encode()


def _readable_document(view: MeasurementDetail, points: list[dict[str, Any]] | None) -> MeasurementRead:
    measurement, result = view.measurement, view.measurement.result
    failure = None
    if measurement.failure_code is not None:
        failure = {
            "code": measurement.failure_code,
            "detail": measurement.failure_detail,
            "advice": measurement.failure_advice,
        }
    return stored_document(
        MeasurementRead,
        {
            "id": measurement.id,
            "session_id": measurement.session_id,
            "pose_id": measurement.pose_id,
            "cycle": measurement.cycle,
            "burst": measurement.burst or 1,
            "target_id": measurement.target_id,
            "siblings": view.siblings,
            "focus_group": measurement.focus_group,
            "joint_angles_deg": measurement.joint_angles_deg,
            "captured_at": measurement.captured_at,
            "received_at": measurement.received_at,
            "finished_at": measurement.finished_at,
            "sha256": measurement.sha256,
            "filename": measurement.filename,
            "pose_label": measurement.pose_label,
            "bytes": measurement.bytes,
            "status": measurement.status,
            "attempts": measurement.attempts,
            "duration_ms": rounded(measurement.duration_ms, "duration_ms"),
            "failure": failure,
            "retry_failure": measurement.retry_failure,
            "excluded": measurement.excluded,
            "calibration": result.calibration if result is not None else None,
            "labelling": result.labelling if result is not None else None,
            "capture_quality": rounded(quality_document(measurement), "capture_quality"),
            "points": rounded(points),
        },
        "measurement",
    )


def _unreadable_document(view: MeasurementDetail, error: RowUnreadable) -> MeasurementRead:
    measurement = view.measurement
    damaged = unreadable_columns(measurement)
    fields = {
        name: (_BLANK.get(name) if name in damaged else getattr(measurement, name, None))
        for name in MeasurementRead.model_fields
    }
    fields["burst"] = fields["burst"] or 1
    if "received_at" in damaged:
        fields["received_at"] = moment_of(measurement.id)
    failure = {"code": error.code, "detail": error.detail, "advice": _RETRY}
    if measurement.failure_code == error.code and "failure_detail" not in damaged:
        failure["detail"] = measurement.failure_detail or error.detail
    return MeasurementRead.model_validate(
        {**fields, "siblings": view.siblings, "status": "failed", "failure": failure}
    )


def quality_document(measurement: Measurement) -> dict[str, Any] | None:
    """Return how well a measurement's image was taken, in the API's units; None where that is not known.

    Raises RowUnreadable.
    """
    stored = measurement.result.capture_quality if measurement.result is not None else None
    if stored is None:
        return None
    try:
        direction, tilt = stored["motion_blur_direction"], stored["tilt"]
        return {
            **{name: stored[name] for name in _PLAIN_FIGURES},
            "motion_blur_direction_deg": math.degrees(direction) if direction is not None else None,
            "tilt_deg": math.degrees(tilt) if tilt is not None else None,
            "warnings": stored["advice"],
        }
    except (KeyError, TypeError) as error:
        raise RowUnreadable("measurement", ["capture_quality"], _RETRY) from error


class WholeFileResponse(FileResponse):
    """A file, whole whatever range was asked for, which HTTP allows.

    Starlette answers ranges it cannot serve with plain text, where this service answers problems only.
    """

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = [(name, value) for name, value in scope["headers"] if name not in (b"range", b"if-range")]
        self.headers["accept-ranges"] = "none"
        await super().__call__({**scope, "headers": headers}, receive, send)


class OpenFileResponse(FileResponse):
    """A file that is open already, whole from its beginning: what was looked at is sent, whatever has its name by now.

    It is closed when the answer has ended, in whatever way.
    """

    chunk_size = 1024 * 1024

    def __init__(self, file: FileIO, *, media_type: str, filename: str) -> None:
        super().__init__(
            str(file.name), media_type=media_type, filename=filename, stat_result=os.fstat(file.fileno())
        )
        self.headers["accept-ranges"] = "none"
        self._file = file

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await send(
                {"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers}
            )
            while chunk := await run_in_threadpool(self._file.read, self.chunk_size):
                await send({"type": "http.response.body", "body": chunk, "more_body": True})
            await send({"type": "http.response.body", "body": b"", "more_body": False})
        finally:
            self._file.close()
