"""Rows that a migration writes anew: documents, grades, hashes of arrays, and keys that are no longer limited."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import sqlalchemy as sa

from app.records import migrations
from app.records.codec import content_hash
from app.records.database import Database
from app.records.ids import new_id
from app.records.tables import (
    ApiKey,
    Measurement,
    Result,
    Robot,
)
from tests.support.records.filled_tables import NOW, SINCE_0004, fill, lacking
from tests.support.service.backups import content


def test_stored_documents_take_the_names_of_the_contract(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    fill(database)
    joint = {"a_mm": 1.5, "minimum_deg": -90.0, "maximum_deg": 90.0}
    calibration = {
        "initialisation": "nullspace",
        "pose": {"covariance_given_camera": [[1.0]]},
        "observability": {"ambiguity_log_likelihood_ratio": None, "tilt_deg": 3.0},
    }
    with database.write() as records:
        records.execute(sa.update(Robot).values(joints=[joint], datasheet_repeatability_mm=0.04))
        records.execute(sa.update(Result).values(calibration=calibration, labelling="up_to_symmetry"))
    before = content(database)
    migrations.downgrade(database, "0009")
    with database.engine.begin() as connection:
        older = connection.execute(sa.text("SELECT origin, calibration FROM results")).one()
        assert older[0] == "turned"
        stored = older[1] if isinstance(older[1], dict) else json.loads(older[1])
        assert stored["start"] == "nullspace"
        assert stored["pose"] == {"conditional_covariance": [[1.0]]}
        assert stored["observability"] == {"pose_ambiguity_ratio": None, "tilt_deg": 3.0}
        joints, repeatability_mm = connection.execute(
            sa.text("SELECT joints, repeatability_mm FROM robots")
        ).one()
        joints = joints if isinstance(joints, list) else json.loads(joints)
        assert (joints[0]["lower_deg"], joints[0]["upper_deg"], repeatability_mm) == (-90.0, 90.0, 0.04)
        # The older version's statistic cannot be converted: a retry computes the new one.
        stored["observability"]["pose_ambiguity_ratio"] = 0.5
        connection.execute(sa.text("UPDATE results SET calibration = :new"), {"new": json.dumps(stored)})
    migrations.upgrade(database, tmp_path)
    assert content(database) == before


def test_stored_calibrations_get_their_grade_and_interval(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    fill(database)
    calibration = {
        "grade": "weak",
        "intrinsics": {"fx_px": 1000.0, "fy_px": 900.0},
        "standard_uncertainty": {"fx_px": 50.0, "fy_px": 45.0},
        "interval_95": {"fx_px": [906.650, 1102.961], "fy_px": [815.985, 992.665]},
        "observability": {"focal_relative_uncertainty": 0.05},
    }
    with database.write() as records:
        records.execute(sa.update(Result).values(calibration=calibration))
    migrations.downgrade(database, "0011")
    with database.engine.begin() as connection:
        stored = connection.scalar(sa.text("SELECT calibration FROM results"))
        older = stored if isinstance(stored, dict) else json.loads(stored)
        assert not {"grade", "interval_95"} & set(older)
    migrations.upgrade(database, tmp_path)
    (row,) = content(database)["results"]
    found = row["calibration"]
    assert found["grade"] == "weak"
    for name, interval in calibration["interval_95"].items():  # type: ignore[attr-defined]
        assert found["interval_95"][name] == pytest.approx(interval, abs=1e-3)
    assert {**found, "interval_95": None} == {**calibration, "interval_95": None}


def test_a_limited_key_opens_nothing_in_the_older_version(database: Database, tmp_path: Path) -> None:
    """The older version knows neither limits nor `ingest`: it would open everything to such a key."""
    migrations.upgrade(database, tmp_path)
    fill(database)
    limited = {"scope": "read", "session_ids": ["ses_x"]}
    names = {"limited": limited, "machine": {"scope": "ingest"}, "plain": {"scope": "upload"}}
    with database.write() as records:
        for name, fields in names.items():
            key = ApiKey(id=new_id("key"), name=name, secret_hmac="1" * 64, created_at=NOW, **fields)
            records.add(key)
    migrations.downgrade(database, "0004")
    with database.engine.connect() as connection:
        rows = connection.execute(sa.text("SELECT name, scope, revoked_at FROM api_keys"))
        found = {row.name: (row.scope, row.revoked_at is not None) for row in rows}
    assert found == {
        "k": ("read", False),
        "limited": ("read", True),
        "machine": ("read", True),
        "plain": ("upload", False),
    }
    migrations.upgrade(database, tmp_path)


@pytest.mark.slow
def test_results_of_before_get_the_hash_of_their_arrays(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    rows = [
        {
            **before["measurements"][0],
            "id": new_id("mea"),
            "sha256": f"{k:064}",
            "seeks_target": False,
            "stated_target_id": before["measurements"][0]["target_id"],
        }
        for k in range(1, 1204)
    ]
    kinds = [(None, None), (b"", None), (b"\1\2", b"\3"), (b"\1", b"\2\3")]
    with database.write() as records:
        records.execute(sa.insert(Measurement), rows)
        results = []
        for k, row in enumerate(rows):
            points, markers = kinds[k % len(kinds)]
            arrays = {
                "points": points,
                "markers": markers,
                "content_sha256": content_hash(points, markers),
            }
            results.append({**before["results"][0], **arrays, "measurement_id": row["id"]})
        records.execute(sa.insert(Result), results)
    before = content(database)
    assert len({row["content_sha256"] for row in before["results"]}) == 1 + len(kinds)
    migrations.downgrade(database, "0004")
    migrations.upgrade(database, tmp_path)
    assert content(database) == lacking(before, *SINCE_0004)
