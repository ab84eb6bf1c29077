"""Finished measurements in a service's database, as its workers would have left them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from app.records.codec import encode_calibration, encode_refused
from app.records.database import Database
from app.records.ids import new_id
from app.records.outcome import Provenance
from app.records.tables import Measurement, Result
from app.services.poses import get_or_create_pose
from app.settings import Settings
from core import calibrate_points
from core.errors import FocalNotObservable
from core.targets import GridPoints

_AT_ONCE = 2000


@dataclass(frozen=True, slots=True)
class Visit:
    """One image of a pose: the points that were found, and the joint angles (degrees) that the robot read."""

    pose_id: str
    cycle: int
    points: GridPoints
    joint_angles_deg: list[float] | None = None


def store(folder: Path, session_id: str, target_id: str, visits: Iterable[Visit]) -> None:
    """Store visits as measurements with results. The calibration of one stands for all: analyses read points alone."""
    database = Database(Settings(data_dir=folder).effective_database_url)
    waiting = iter(visits)
    document: dict[str, Any] | None = None
    poses: set[str] = set()
    while several := list(islice(waiting, _AT_ONCE)):
        with database.write() as records:
            for pose_id in sorted({visit.pose_id for visit in several} - poses):
                get_or_create_pose(records, session_id, pose_id)
                poses.add(pose_id)
            records.flush()
            document = document or _calibrated(visit.points for visit in several)
            rows = [_rows(visit, document, session_id, target_id) for visit in several]
            records.execute(sa.insert(Measurement), [measurement for measurement, _ in rows])
            records.execute(sa.insert(Result), [result for _, result in rows])
    database.dispose()


def _calibrated(views: Iterable[GridPoints]) -> dict[str, Any]:
    for points in views:
        with suppress(FocalNotObservable):
            return encode_calibration(calibrate_points(points), Provenance("0.1.0", "0" * 64, {}))
    raise ValueError("The focal length is not observable in any of the first views.")


def _rows(
    visit: Visit, document: dict[str, Any], session_id: str, target_id: str
) -> tuple[dict[str, Any], dict[str, Any]]:
    points = visit.points
    sha256 = hashlib.sha256(points.points_px.tobytes()).hexdigest()
    stored = encode_refused(points, Provenance("0.1.0", sha256, {}))
    measurement = {
        "id": new_id("mea"),
        "session_id": session_id,
        "pose_id": visit.pose_id,
        "target_id": target_id,
        "cycle": visit.cycle,
        "focus_group": "default",
        "joint_angles_deg": visit.joint_angles_deg,
        "received_at": datetime.now(UTC),
        "finished_at": datetime.now(UTC),
        "sha256": sha256,
        "bytes": 1,
        "image_format": "png",
        "image_width_px": points.image_width_px,
        "image_height_px": points.image_height_px,
        "status": "succeeded",
        "attempts": 1,
    }
    result = {
        **document,
        "points": stored["points"],
        "content_sha256": stored["content_sha256"],
        "measurement_id": measurement["id"],
    }
    return measurement, result
