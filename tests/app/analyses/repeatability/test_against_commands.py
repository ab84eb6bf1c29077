"""Accuracy against the commanded poses, and boards that only these can orient."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from core.calibration.multi_view.board_symmetry import symmetry_rotations
from core.geometry.camera import project
from core.geometry.se3 import (
    compose,
    invert,
    so3_exp,
    transform,
    transform_points,
)
from core.targets.specification import TargetSpec
from tests.support.sessions.repeatability import command, deviating_robot, table
from tests.support.sessions.stored_sessions import (
    CAMERA,
    Shot,
    Store,
    new_session,
    shoot,
)


def turned(rng: np.random.Generator, shots: list[Shot], board: TargetSpec) -> list[Shot]:
    """The same images as a detector reads them that cannot determine which way round the board is."""
    turns = symmetry_rotations(board)
    seen = []
    for shot in shots:
        turn = turns[int(rng.integers(len(turns)))]
        assert shot.points is not None
        exact = project(
            transform_points(compose(invert(shot.T_target_camera), turn), board.points_target()), CAMERA
        )
        noise = rng.normal(0.0, 0.02, exact.shape)
        seen.append(
            dataclasses.replace(
                shot,
                points=dataclasses.replace(shot.points, points_px=exact + noise, labelling="up_to_symmetry"),
            )
        )
    return seen


@pytest.mark.slow
def test_a_board_that_looks_the_same_turned_gets_one_labelling(api: Any, store: Store) -> None:
    board = TargetSpec("chessboard", 10, 6, 12.0)
    rng = np.random.default_rng(14)
    shots = turned(rng, shoot(seed=14, cycles=10, board=board), board)
    session = new_session(api, board)
    store(api, session, shots)
    document = table(api, session)
    assert all(row["repeatability"]["rp_l_mm"] < 0.5 for row in document["poses"])
    (warning,) = [w for w in document["warnings"] if w["code"] == "board_symmetry_unresolved"]
    assert "turns least" in warning["detail"]
    mounting = transform(so3_exp(np.array([0.3, -2.0, 0.4])), np.array([20.0, 10.0, 80.0]))
    base = transform(so3_exp(np.array([-0.5, 0.2, 1.4])), np.array([700.0, -100.0, 300.0]))
    commanded = {shot.pose_id: compose(base, shot.T_target_camera, mounting) for shot in shots[:5]}
    command(api, session, commanded)
    document = table(api, session)
    assert "board_symmetry_unresolved" not in {w["code"] for w in document["warnings"]}
    means = [np.array(row["mean"]["position_mm"]) for row in document["poses"]]
    true = [shot.T_target_camera[:3, 3] for shot in shots[:5]]
    # Distances between poses are the robot's, whichever way the whole was read.
    for i in range(5):
        for j in range(i):
            assert np.linalg.norm(means[i] - means[j]) == pytest.approx(
                np.linalg.norm(true[i] - true[j]), abs=0.3
            )


@pytest.mark.slow
@pytest.mark.parametrize("angles", [True, False])
def test_accuracy_against_the_commanded_poses(api: Any, store: Store, angles: bool) -> None:
    shots, commanded, off = deviating_robot(15, 24, 0.5)
    session = new_session(api)
    store(api, session, shots)
    command(api, session, commanded, angles=angles)
    document = table(api, session)
    errors = []
    for row in document["poses"]:
        found = row["accuracy"]
        attained = np.array([found[name] for name in ("ap_x_mm", "ap_y_mm", "ap_z_mm")])
        errors.append(attained - off[row["pose_id"]])
        assert found["ap_p_mm"] == pytest.approx(float(np.linalg.norm(attained)), rel=1e-4)
        assert (found["ap_yaw_deg"] is None) == (not angles)
    # The frames are tied by 24 poses that are themselves off by .5 mm an axis: about a fifth of that remains.
    assert np.sqrt(np.mean(np.square(errors))) < 0.3
    assert "accuracy_unavailable" not in {w["code"] for w in document["warnings"]}


def test_without_motion_there_is_no_accuracy_and_a_reason(api: Any, store: Store) -> None:
    session = new_session(api)
    shots = shoot(seed=16, poses=1, cycles=3)
    store(api, session, shots)
    command(api, session, {"P1": shots[0].T_target_camera})
    document = table(api, session)
    assert document["poses"][0]["accuracy"] is None
    (warning,) = [w for w in document["warnings"] if w["code"] == "accuracy_unavailable"]
    assert warning["advice"]
