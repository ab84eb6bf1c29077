"""Sessions and queued rows written straight to a database, without images."""

from __future__ import annotations

from datetime import UTC, datetime

import sqlalchemy as sa

from app.records.database import Database
from app.records.ids import new_id
from app.records.tables import Measurement, Pose, Session, SessionTarget, Target


def make_session(database: Database) -> str:
    session_id, target_id, now = new_id("ses"), new_id("tgt"), datetime.now(UTC)
    with database.write() as records:
        target = {"id": target_id, "name": "board", "kind": "chessboard", "columns": 9, "rows": 6}
        rest = {"pitch_mm": 25.0, "legacy_layout": False, "created_at": now}
        records.execute(sa.insert(Target), [{**target, **rest}])
        records.execute(sa.insert(Session), [{"id": session_id, "name": "s", "created_at": now}])
        position = {"session_id": session_id, "position": 0, "target_id": target_id}
        records.execute(sa.insert(SessionTarget), [position])
        records.execute(sa.insert(Pose), [{"id": new_id("pos"), "session_id": session_id, "pose_id": "P1"}])
    return session_id


QUEUED = {
    "focus_group": "default",
    "bytes": 1,
    "image_format": "png",
    "image_width_px": 1,
    "image_height_px": 1,
    "status": "queued",
    "attempts": 0,
}
"""What rows of images that wait have in common; there is no file."""


def enqueue(database: Database, session_id: str, images: int) -> list[str]:
    """Queue so many images of a session as uploads do, and return their measurements in that order."""
    now, ids = datetime.now(UTC), [new_id("mea") for _ in range(images)]
    with database.write() as records:
        target_id = records.scalar(
            sa.select(SessionTarget.target_id).where(SessionTarget.session_id == session_id)
        )
        of_all = {
            "session_id": session_id,
            "pose_id": "P1",
            "target_id": target_id,
            "received_at": now,
            **QUEUED,
        }
        records.execute(
            sa.insert(Measurement),
            [{**of_all, "id": i, "sha256": i.removeprefix("mea_").encode().hex().zfill(64)} for i in ids],
        )
    return ids
