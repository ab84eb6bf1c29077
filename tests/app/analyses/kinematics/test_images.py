"""A robot's kinematics over HTTP from images of targets."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from core.geometry.se3 import invert, so3_log
from core.kinematics.dh import forward
from core.simulation.arm import KR5_ARC_HOME, Arm, free_angles, kr5_arc, sweep_angles
from core.targets.specification import GridPoints, TargetSpec
from tests.support.sessions.kinematics import document, error_mm, get, make_robot
from tests.support.sessions.stored_sessions import (
    BOARD,
    CAMERA,
    Shot,
    Store,
    draw_board_pose,
    look,
    new_session,
    problem,
)

OTHER = TargetSpec("chessboard", 8, 5, 15.0)


EVEN = TargetSpec("chessboard", 8, 6, 12.0)  # looks the same when turned


def photographed(
    seed: int, boards: list[TargetSpec], *, arc_deg: float = 8.0, free: int = 12
) -> tuple[Arm, list[list[Shot]], Any]:
    """A KR5 whose camera sees boards from its flange: what a detector found in every image, board by board."""
    rng = np.random.default_rng(seed)
    arm = kr5_arc(rng)
    at_home = forward(arm.chain, KR5_ARC_HOME[None])[0] @ arm.T_flange_camera
    bases = [invert(draw_board_pose(rng, 25.0, board)) @ invert(at_home) for board in boards]
    arm = Arm(arm.chain, np.array(bases), arm.T_flange_camera)
    q = sweep_angles(KR5_ARC_HOME, half_arc=math.radians(arc_deg), steps=5)
    q = np.concatenate([q, free_angles(rng, KR5_ARC_HOME, free, half_range=math.radians(arc_deg))])
    T = [arm.camera_poses(q, np.full(len(q), index)) for index in range(len(boards))]
    seen = [[look(rng, invert(pose), board=board) for pose in T[k]] for k, board in enumerate(boards)]
    shown = [i for i in range(len(q)) if all(_near_the_image(views[i]) for views in seen)]
    shots = [
        [Shot(f"P{n + 1}", None, seen[k][i], T[k][i]) for n, i in enumerate(shown)]
        for k in range(len(boards))
    ]
    return arm, shots, q[shown]


def _near_the_image(points: GridPoints) -> bool:
    """Whether the board is where a wider image would show it; beyond, the lens's model bends back on itself."""
    size = np.array([points.image_width_px, points.image_height_px])
    return bool(np.all(points.points_px >= -size) and np.all(points.points_px <= 2.0 * size))


def send_angles(api: Any, session: str, q: Any) -> None:
    commanded = [
        {"pose_id": f"P{i + 1}", "joint_angles_deg": np.degrees(angles).tolist()}
        for i, angles in enumerate(q)
    ]
    assert api.client.post(f"/v1/sessions/{session}/poses", json=commanded).status_code == 200


@pytest.mark.slow
@pytest.mark.parametrize(
    ("board", "estimator"), [(BOARD, "pooled"), (EVEN, "pooled"), (BOARD, "given"), (BOARD, "per_image")]
)
def test_images_find_the_robot(api: Any, store: Store, board: TargetSpec, estimator: str) -> None:
    arm, (shots,), q = photographed(11, [board])
    session = new_session(api, board, robot_id=make_robot(api), intrinsics=dataclasses.asdict(CAMERA))
    send_angles(api, session, q)
    store(api, session, shots)
    found = document(get(api, session, estimator=estimator))
    assert (found["source"], found["estimator"]) == ("images", estimator)
    # The robot is perfect here; each image by itself is worse by far (METHOD, section 4).
    assert error_mm(found, arm, q) < (1.0 if estimator == "per_image" else 0.05)


def test_an_image_s_own_angles_override_its_pose_s(api: Any, store: Store) -> None:
    arm, (shots,), q = photographed(12, [BOARD], free=4)
    session = new_session(api, robot_id=make_robot(api))
    wrong = q + np.radians(np.random.default_rng(1).uniform(2.0, 5.0, q.shape))
    send_angles(api, session, wrong)
    own = [
        dataclasses.replace(shot, fields={"joint_angles_deg": np.degrees(angles).tolist()})
        for shot, angles in zip(shots, q, strict=True)
    ]
    store(api, session, own)
    assert error_mm(document(get(api, session)), arm, q) < 0.1


def test_images_without_angles_are_excluded_and_named(api: Any, store: Store) -> None:
    arm, (shots,), q = photographed(13, [BOARD], free=6)
    session = new_session(api, robot_id=make_robot(api))
    store(api, session, shots)
    problem(get(api, session), 409, "joint_angles_missing")
    send_angles(api, session, q[:-1])
    found = document(get(api, session))
    (warning,) = (w for w in found["warnings"] if w["code"] == "joint_angles_missing")
    assert f"P{len(q)}" in warning["detail"]
    assert error_mm(found, arm, q) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("method", ["global", "combined"])
def test_two_targets_in_one_session(api: Any, store: Store, method: str) -> None:
    """Sweeps of some joints seen on one board, of the others on the other, and some images of both."""
    arm, (first, second), q = photographed(14, [BOARD, OTHER], free=8)
    session = new_session(api, BOARD, OTHER, robot_id=make_robot(api))
    targets = api.client.get(f"/v1/sessions/{session}").json()["target_ids"]
    send_angles(api, session, q)
    store(api, session, [s for i, s in enumerate(first) if i < 18 or i >= 30], targets[0])
    store(api, session, [s for i, s in enumerate(second) if i >= 15], targets[1])
    found = document(get(api, session, method=method))
    (between,) = found["target_transforms"]
    assert (between["from_target_id"], between["to_target_id"]) == tuple(targets)
    T = arm.T_target_base[0] @ invert(arm.T_target_base[1])
    said = np.array(between["T_from_to"])
    assert np.linalg.norm(said[:3, 3] - T[:3, 3]) < 0.2
    assert np.linalg.norm(so3_log(said[:3, :3] @ T[:3, :3].T)) < math.radians(0.05)
    assert np.all(np.linalg.eigvalsh(np.array(between["covariance"])) > 0.0)
    if method == "global":
        for target in (0, 1):
            assert error_mm(found, arm, q, target) < 0.1


@pytest.mark.slow
def test_roll_pitch_yaw_of_the_commands_are_not_needed(api: Any, store: Store) -> None:
    """A board that looks the same when turned is read by the nominal robot's orientations."""
    _, (shots,), q = photographed(15, [EVEN], free=6)
    turned = []
    for i, shot in enumerate(shots):
        points = shot.points
        assert points is not None
        points = dataclasses.replace(points, labelling="up_to_symmetry")
        if i % 3 == 0:  # as a detector would name them in an image that is turned past the vertical
            points = dataclasses.replace(
                points, column=EVEN.columns - 1 - points.column, row=EVEN.rows - 1 - points.row
            )
        turned.append(dataclasses.replace(shot, points=points))
    session = new_session(api, EVEN, robot_id=make_robot(api))
    send_angles(api, session, q)
    store(api, session, turned)
    found = document(get(api, session))
    assert found["residual"]["position_rms_mm"] < 0.1
    other = new_session(api, EVEN, robot_id=make_robot(api))
    send_angles(api, other, q)
    store(api, other, shots)
    plain = document(get(api, other))
    # The frame is the first image's reading in both; the robot is the same one.
    for one, two in zip(found["joints"], plain["joints"], strict=True):
        assert one["a_mm"] == pytest.approx(two["a_mm"], abs=1e-3)
