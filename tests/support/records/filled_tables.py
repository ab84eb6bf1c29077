"""A row in every table, and what a schema of another revision holds of them."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from alembic.script import ScriptDirectory

from app.records import migrations
from app.records.codec import content_hash
from app.records.database import Database
from app.records.ids import new_id
from app.records.tables import (
    ApiKey,
    MeasuredPose,
    Measurement,
    Pose,
    Removal,
    Result,
    Robot,
    Session,
    SessionTarget,
    Target,
)
from tests.support.service.backups import content

SINCE_0004 = ("removals",)
NOW = datetime(2026, 1, 31, 12, 0, 0, 123456, tzinfo=UTC)


def fill(database: Database) -> dict[str, list[dict[str, Any]]]:
    """Put a row into every table but the audit trail and the installation, and return what each then holds."""
    session_id, target_id, robot_id, measurement_id = (new_id(p) for p in ("ses", "tgt", "rob", "mea"))
    with database.write() as records:
        records.add(ApiKey(id=new_id("key"), name="k", scope="read", secret_hmac="0" * 64, created_at=NOW))
        records.add(
            Target(
                id=target_id,
                name="ø",
                kind="chessboard",
                columns=9,
                rows=6,
                pitch_mm=0.1,
                legacy_layout=True,
                created_at=NOW,
            )
        )
        records.add(Removal(sha256="1" * 64, recorded_at=NOW))
        records.add(Robot(id=robot_id, name="r", joints=[{"a_mm": 1.5}], created_at=NOW))
        records.flush()
        records.add(
            Session(id=session_id, name="s", robot_id=robot_id, lens={"focal_length_mm": 8.0}, created_at=NOW)
        )
        records.flush()
        records.add(SessionTarget(session_id=session_id, position=0, target_id=target_id))
        records.add(Pose(id=new_id("pos"), session_id=session_id, pose_id="P1", position_mm=[1, 2, 3]))
        records.flush()
        records.add(
            MeasuredPose(
                id=new_id("mpo"),
                session_id=session_id,
                pose_id="P1",
                position_mm=[0.1, 2.0, 3.0],
                content_sha256="0" * 64,
            )
        )
        records.add(
            Measurement(
                id=measurement_id,
                session_id=session_id,
                pose_id="P1",
                target_id=target_id,
                seeks_target=True,
                focus_group="default",
                received_at=NOW,
                sha256="0" * 64,
                bytes=2**40,
                image_format="png",
                image_width_px=1,
                image_height_px=1,
                status="succeeded",
                attempts=1,
            )
        )
        records.flush()
        records.add(
            Result(
                measurement_id=measurement_id,
                estimator="per_image",
                calibration={"f": 0.1 + 0.2},
                points=b"\0\1",
                content_sha256=content_hash(b"\0\1", None),
                core_version="1",
                settings={},
                input_sha256="0" * 64,
            )
        )
    return content(database)


def lacking(content: dict[str, list[dict[str, Any]]], *tables: str) -> dict[str, list[dict[str, Any]]]:
    """Return the content without the rows of tables that the revision gone back to does not have."""
    return {**content, **{table: [] for table in tables}}


def revisions() -> list[str]:
    """Every revision, first to last."""
    scripts = ScriptDirectory.from_config(migrations.migration_config())
    return [script.revision for script in reversed(list(scripts.walk_revisions()))]
