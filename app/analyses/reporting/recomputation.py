"""A report's session as the report states it, with the grid points that are stored: what its figures are computed from
again, whatever was corrected, excluded, moved or added since.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.analyses.inputs.session_loader import load_session
from app.analyses.inputs.snapshot import Snapshot, StoredImage, StoredPose
from app.analyses.inputs.snapshot_reader import parameters_of
from app.analyses.reporting.changes import NO_POINTS, changed_input, points_of
from app.analyses.reporting.inputs import OF_POSE, OF_ROBOT, OF_TARGET, target_row
from app.analyses.worker import LoadedSession
from app.records.tables import MeasuredPose, Measurement, Result, measured_target_fields
from core.session import NO_TARGET, CommandedPose, ImageObservation

Json = dict[str, Any]
_OF_IMAGE = ("failure_detail", "labelling", "captured_at", "received_at", "image_width_px", "image_height_px")
"""Fields that reports state since they are verified from what they state; earlier ones lack them."""
_NEVER_CHANGED = {
    f"image.{name}" for name in ("captured_at", "received_at", "image_width_px", "image_height_px")
}
"""Of these, what is stored now is what was stored then."""
_COLUMNS = (
    *(Measurement.id, Measurement.failure_code, Measurement.failure_detail),
    *(Measurement.image_width_px, Measurement.image_height_px),
    *(Measurement.captured_at, Measurement.received_at),
    *(Result.content_sha256, Result.labelling, sa.func.length(Result.points).label("point_bytes")),
)


@dataclass(frozen=True, slots=True)
class ReportedSession:
    """The session that a report is of, as it was.

    `loaded` is None where something is not stored any more without which no figure can be computed: `unavailable` names
    it. `current_values` names the fields that the report, which an earlier version made, does not state, so that
    they are as they are stored now.
    """

    loaded: LoadedSession | None
    unavailable: list[Json]
    current_values: list[str]


def load_reported(records: orm.Session, then: Mapping[str, Any], now: Json) -> ReportedSession:
    """Return the session of the report's document `then`, in whose place there are the inputs `now`.

    Raises RowUnreadable.
    """
    inputs, session_id = then["inputs"], then["inputs"]["session"]["id"]
    rows = _read_rows(records, session_id) if inputs["images"] else {}
    unavailable = [*_lost_images(inputs["images"], rows), *_lost_readings(records, session_id, inputs)]
    if unavailable:
        return ReportedSession(None, unavailable, [])
    merged, current_values = _completed(inputs, now, rows)
    snapshot = _snapshot(merged, rows, then["subject"])
    loaded = LoadedSession(snapshot, load_session(records, snapshot, then["source"]), {}, None, "")
    return ReportedSession(loaded, [], current_values)


def _read_rows(records: orm.Session, session_id: str) -> dict[str, sa.Row[Any]]:
    statement = (
        sa.select(*_COLUMNS)
        .outerjoin(Result, Result.measurement_id == Measurement.id)
        .where(Measurement.session_id == session_id)
    )
    return {row.id: row for row in records.execute(statement)}


def _lost_images(images: Sequence[Json], rows: Mapping[str, sa.Row[Any]]) -> list[Json]:
    """Return the images whose grid points are not stored any more as they were."""
    lost = []
    for image in images:
        row, content = rows.get(image["measurement_id"]), image["content_sha256"]
        change = None
        if row is None:
            needs_row = content not in (None, NO_POINTS) or any(name not in image for name in _OF_IMAGE)
            change = "deleted" if needs_row else None
        elif content not in (None, NO_POINTS, row.content_sha256):
            change = f"measured again, to {points_of(content, row.content_sha256)}"
        if change is not None:
            lost.append(changed_input("image", image["measurement_id"], change))
    return lost


def _lost_readings(records: orm.Session, session_id: str, inputs: Json) -> list[Json]:
    """Return the poses of another instrument that are not stored any more as they were."""
    if not inputs["measured_poses"]:
        return []
    columns = sa.select(MeasuredPose.id, MeasuredPose.content_sha256)
    found = {
        row.id: row.content_sha256
        for row in records.execute(columns.where(MeasuredPose.session_id == session_id))
    }
    return [
        changed_input("measured_pose", one["measurement_id"], "deleted")
        for one in inputs["measured_poses"]
        if found.get(one["measurement_id"]) != one["content_sha256"]
    ]


def _completed(inputs: Json, now: Json, rows: Mapping[str, sa.Row[Any]]) -> tuple[Json, list[str]]:
    """Return a report's inputs with the fields that it does not state as they are now, and these fields' names."""
    names: set[str] = set()

    def complete(noun: str, before: Json, after: Mapping[str, Any] | None, fields: Sequence[str]) -> Json:
        absent = {name: (after or {}).get(name) for name in fields if name not in before}
        names.update(f"{noun}.{name}" for name, value in absent.items() if value is not None)
        return {**before, **absent}

    targets = {one["id"]: one for one in now["targets"]}
    poses = {one["pose_id"]: one for one in now["poses"]}
    images = {one["measurement_id"]: one for one in now["images"]}
    robot = inputs["robot"]
    if robot is not None:
        after = now["robot"] if (now["robot"] or {}).get("id") == robot["id"] else None
        robot = complete("robot", robot, after, OF_ROBOT)
    merged = {
        **inputs,
        "robot": robot,
        "targets": [complete("target", one, targets.get(one["id"]), OF_TARGET) for one in inputs["targets"]],
        "poses": [complete("pose", one, poses.get(one["pose_id"]), OF_POSE) for one in inputs["poses"]],
        "images": [
            complete("image", one, _current(one, images, rows), _OF_IMAGE) for one in inputs["images"]
        ],
    }
    return merged, sorted(names - _NEVER_CHANGED)


def _current(image: Json, now: Mapping[str, Json], rows: Mapping[str, sa.Row[Any]]) -> Json:
    """Return what is stored now of the fields that an earlier version's report does not state of an image.

    The reason of a failure is that of the same failure alone.
    """
    row, today = rows.get(image["measurement_id"]), now.get(image["measurement_id"])
    if row is None:
        return {}
    found = {name: getattr(row, name) for name in _OF_IMAGE}
    code = image["failure_code"]
    if today is not None and today["failure_code"] == code:
        found["failure_detail"] = today["failure_detail"]
    elif row.failure_code != code:
        found["failure_detail"] = None
    return found


def _snapshot(inputs: Json, rows: Mapping[str, sa.Row[Any]], subject: Mapping[str, Any]) -> Snapshot:
    session, robot = inputs["session"], inputs["robot"]
    places = {target["id"]: place for place, target in enumerate(inputs["targets"])}
    return Snapshot(
        session_id=session["id"],
        target_ids=tuple(places),
        targets=tuple(
            measured_target_fields(target_row(one), session["conditions"]) for one in inputs["targets"]
        ),
        lens=session["lens"],
        intrinsics=session["intrinsics"],
        camera_mount="fixed" if session.get("camera_mount") == "fixed" else "robot",
        commanded={
            one["pose_id"]: CommandedPose(**{name: one[name] for name in OF_POSE}) for one in inputs["poses"]
        },
        images=tuple(_image(one, rows.get(one["measurement_id"]), places) for one in inputs["images"]),
        measured=tuple(
            StoredPose(one["measurement_id"], one["pose_id"], one["cycle"], one["content_sha256"])
            for one in inputs["measured_poses"]
        ),
        subject=subject,
        robot=None if robot is None else [parameters_of(joint) for joint in robot["joints"]],
        joint_coupling=None if robot is None else robot["joint_coupling"],
        datasheet={}
        if robot is None
        else {
            "repeatability_mm": robot["datasheet_repeatability_mm"],
            "accuracy_mm": robot["datasheet_accuracy_mm"],
        },
        pending=0,
    )


def _image(image: Json, row: sa.Row[Any] | None, places: Mapping[str, int]) -> StoredImage:
    content = image["content_sha256"]
    stored = row if row is not None and content == row.content_sha256 else None
    observation = ImageObservation(
        measurement_id=image["measurement_id"],
        pose_id=image["pose_id"],
        cycle=image["cycle"],
        image=image["sha256"],
        target=NO_TARGET if image["target_id"] is None else places[image["target_id"]],
        focus_group=image["focus_group"],
        joint_angles_deg=image["joint_angles_deg"],
        width_px=image["image_width_px"],
        height_px=image["image_height_px"],
        failure_code=image["failure_code"],
        failure_detail=image["failure_detail"],
        labelling=image["labelling"] or "absolute",
        filename=image["filename"],
        burst=image.get("burst"),
    )
    return StoredImage(
        observation,
        stored.point_bytes if stored is not None else None,
        image["computed_by"],
        content,
        image["labelling"] if stored is not None else None,
        _moment(image["captured_at"]),
        _moment(image["received_at"]),
        image.get("stated_target_id"),
    )


def _moment(value: Any) -> datetime | None:
    """Return a time as reports state it, or as it is stored; None of one that cannot be read."""
    if isinstance(value, str):
        return datetime.fromisoformat(value)
    return value if isinstance(value, datetime) else None
