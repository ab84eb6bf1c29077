"""What becomes of a session's measurements before anything is identified."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from app.services.analyses.kinematics_poses import POSES_AT_MOST, gather_poses
from app.services.analyses.outcome import CannotAnalyse
from app.services.analyses.snapshot import Commanded, Measured, Reading, Snapshot
from core.errors import JointAnglesInconsistent
from core.kinematics.dh import Chain

SETTINGS = {"source": "measured_poses", "estimator": "pooled"}
TURN = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
COVARIANCE = np.diag([1e-4] * 3 + [1e-10] * 3).tolist()


def session(*readings: dict[str, Any], commanded: dict[str, Commanded] | None = None) -> Snapshot:
    full = [
        Reading(
            **{
                "joint_angles_deg": [10.0, 20.0],
                "position_mm": [float(i), 0.0, 0.0],
                "rotation": TURN,
                "covariance": COVARIANCE,
                **reading,
            }
        )
        for i, reading in enumerate(readings)
    ]
    return Snapshot(
        "ses_1",
        ("tgt_1",),
        ({"kind": "chessboard"},),
        None,
        None,
        commanded or {},
        (),
        0,
        measured=tuple(Measured(f"mpo_{i}", f"P{i}", None, str(i)) for i in range(len(full))),
        readings={f"mpo_{i}": reading for i, reading in enumerate(full)},
    )


def codes(snapshot: Snapshot) -> list[str]:
    return [w.code for w in gather_poses(snapshot, {}, SETTINGS, None).warnings]


def test_readings_become_poses() -> None:
    gathered = gather_poses(session({}, {}), {}, SETTINGS, None)
    assert gathered.poses.joint_angles.tolist() == [[math.radians(10.0), math.radians(20.0)]] * 2
    assert gathered.poses.labels == ("P0", "P1")
    assert gathered.poses.rotations is not None
    assert gathered.poses.rotations.tolist() == [TURN] * 2
    assert (gathered.targets, gathered.warnings) == ((), ())


def test_a_reading_s_own_angles_come_before_its_pose_s() -> None:
    told = Commanded(None, None, None, None, [1.0, 2.0], None)
    poses = gather_poses(
        session({}, {"joint_angles_deg": None}, commanded={"P0": told, "P1": told}), {}, SETTINGS, None
    ).poses
    assert np.degrees(poses.joint_angles).round(9).tolist() == [[10.0, 20.0], [1.0, 2.0]]


def test_what_few_lack_leaves_them_out_and_what_most_lack_leaves_it_out() -> None:
    without = {"rotation": None}
    assert codes(session({}, {}, without)) == ["rotations_missing"]
    assert len(gather_poses(session({}, {}, without), {}, SETTINGS, None).poses) == 2
    positions = gather_poses(session({}, without, without), {}, SETTINGS, None)
    assert positions.poses.rotations is None
    assert len(positions.poses) == 3
    assert [w.code for w in positions.warnings] == ["rotations_left_out"]
    mixed = gather_poses(session({}, {"covariance": None}), {}, SETTINGS, None)
    assert mixed.poses.covariance is None
    assert [w.code for w in mixed.warnings] == ["covariances_left_out"]
    assert codes(session({}, {"joint_angles_deg": None})) == ["joint_angles_missing"]


def test_more_than_memory_holds_and_other_robots_are_refused() -> None:
    with pytest.raises(CannotAnalyse) as refusal:
        gather_poses(session(*[{}] * (POSES_AT_MOST + 1)), {}, SETTINGS, None)
    assert refusal.value.refused.code == "too_many_measurements"
    with pytest.raises(JointAnglesInconsistent):
        gather_poses(session({}), {}, SETTINGS, Chain.from_rows([(0.0, 0.0, 0.0, 0.0)] * 3))
