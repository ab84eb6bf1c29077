"""Drift over blocks of cycles, and the witness that shows what moved."""

from __future__ import annotations

import dataclasses
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa

from app.analyses.documents.repeatability.drift import drift_document
from app.api.schemas.analyses.performance import PoseDrift
from app.records.tables import Measurement
from core.geometry.se3 import compose, invert, transform
from core.session import PoseRow
from core.session.commanded_poses import assess_accuracy
from tests.support.sessions.drifting_robot import SIX, drifting_session
from tests.support.sessions.repeatability import table
from tests.support.sessions.stored_sessions import (
    Store,
    look,
    new_session,
    shoot,
)


@pytest.mark.slow
def test_drift_is_reported_over_blocks_of_cycles(api: Any, store: Store) -> None:
    shots = []
    rng = np.random.default_rng(2)
    for shot in shoot(seed=17, poses=2, cycles=24):
        assert shot.cycle is not None
        moved = transform(np.eye(3), np.array([0.02 * shot.cycle, 0.0, 0.0]))
        true = compose(moved, shot.T_target_camera)
        taken = {"captured_at": datetime(2026, 1, 31, 8, tzinfo=UTC) + timedelta(minutes=6 * shot.cycle)}
        shots.append(
            dataclasses.replace(shot, points=look(rng, invert(true)), T_target_camera=true, fields=taken)
        )
    session = new_session(api)
    ids = store(api, session, shots)
    drift = table(api, session)["drift"]
    assert (drift["against"], drift["time_source"]) == ("time", "captured_at")
    for pose in drift["poses"]:
        assert pose["duration_h"] == pytest.approx(1.2)
        assert [block["mean_time_h"] for block in pose["blocks"]] == pytest.approx([0.45, 1.65])
        off = abs(pose["rate_mm_per_h"][0] - 0.2)  # .02 mm in six minutes
        assert off < 4.0 * pose["rate_standard_uncertainty_mm_per_h"][0] < 0.1
        assert max(pose["shift_standard_uncertainty_deg"]) > 0.0
        # The second block has 14 cycles: from the mean of 1-10 to that of 11-24.
        assert pose["shift_mm"][0] == pytest.approx(0.02 * 12.0, abs=0.08)
        assert [(b["first_cycle"], b["last_cycle"]) for b in pose["blocks"]] == [(1, 10), (11, 24)]
    with api.installation.database.write() as records:
        records.execute(sa.update(Measurement).where(Measurement.id == ids[0]).values(captured_at=None))
        records.execute(sa.update(Measurement).where(Measurement.id == ids[0]).values(attempts=7))
    assert table(api, session)["drift"]["time_source"] == "received_at"


def test_drift_of_accuracy_stands_by_blocks_where_a_pose_has_accuracy() -> None:
    rng = np.random.default_rng(3)
    off, moved, turns = 0.3 * rng.standard_normal((3, 6, 3))
    noise = rng.normal(0.0, 0.01, (6, 20, 3))
    data, visits = drifting_session(turns, off, moved, np.zeros((6, 3)), noise)
    rows = [PoseRow(name, tuple(visits[name]), (), None) for name in SIX]
    accuracy = dict(assess_accuracy(data, visits).poses)
    del accuracy["P6"]
    document = drift_document(rows, data, accuracy)
    assert document is not None
    for one in document["poses"]:
        # Of two blocks of ten cycles; of the length, which has the scatter along three axes, up to three times as many.
        assert all(9.0 <= freedom <= 18.0 for freedom in one["shift_degrees_of_freedom"])
        assert 9.0 <= one["shift_distance_degrees_of_freedom"] <= 54.0
    *with_accuracy, without = [PoseDrift.model_validate(one) for one in document["poses"]]
    for one in with_accuracy:
        first, last = (block.ap_p_mm for block in one.blocks)
        assert first is not None
        assert last is not None
        assert one.dap_mm == pytest.approx(abs(first - last))
        assert one.dap_standard_uncertainty_mm is not None
    assert without.dap_mm is without.dap_standard_uncertainty_mm is without.blocks[0].ap_p_mm is None


@pytest.mark.slow
def test_a_witness_shows_what_moved_and_takes_it_off(api: Any, store: Store) -> None:
    session = new_session(api)
    rng, shots = np.random.default_rng(5), []
    for shot in shoot(seed=5, cycles=12):
        moved = shot.T_target_camera.copy()
        moved[0, 3] += 0.03 * shot.cycle
        shots.append(dataclasses.replace(shot, T_target_camera=moved, points=look(rng, invert(moved))))
    store(api, session, shots)
    plain = table(api, session, witness="P1")
    assert plain["witness"]["moved"]
    assert not plain["witness"]["subtracted"]
    # The camera in the target frame moves against the target.
    assert plain["witness"]["shift_distance_mm"] == pytest.approx(0.33, abs=0.15)
    assert "witness_moved" in {one["code"] for one in plain["warnings"]}
    found = table(api, session, witness="P1", subtract_witness="true")
    rows = {row["pose_id"]: row for row in plain["poses"]}
    for row in found["poses"]:
        assert row["repeatability"]["rp_l_mm"] < 0.8 * rows[row["pose_id"]]["repeatability"]["rp_l_mm"]
    assert table(api, session)["witness"] is None
    answer = api.client.get(f"/v1/sessions/{session}/repeatability", params={"subtract_witness": "true"})
    assert answer.status_code == 422
    answer = api.client.get(f"/v1/sessions/{session}/repeatability", params={"witness": "P9"})
    assert answer.status_code == 409
    assert answer.json()["advice"]
