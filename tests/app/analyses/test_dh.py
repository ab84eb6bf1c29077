"""A robot's kinematics over HTTP: the truth within its stated doubt, every refusal in words, the same bytes always."""

from __future__ import annotations

import dataclasses
import math
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.api.schemas.kinematics import DhAnalysis
from app.cli.import_readings import Layout, read_readings
from app.cli.import_records import read_records
from core.kinematics.dh import Chain, forward
from core.kinematics.poses import PoseData
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, Arm, free_angles, kr5_arc, sweep_angles
from core.simulation.sweeps import Repeatability, measure_poses
from core.simulation.views import draw_pose
from core.targets.specification import GridPoints, TargetSpec
from core.transforms import invert, so3_log
from tests.app.analyses.conftest import (
    BOARD,
    CAMERA,
    WIDTH,
    Shot,
    Store,
    body,
    look,
    new_session,
    problem,
    same_but_for_ids,
)

NAMES = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg")
ROBOT = Repeatability(0.05, math.radians(0.004))
OTHER = TargetSpec("chessboard", 8, 5, 15.0)
EVEN = TargetSpec("chessboard", 8, 6, 12.0)  # looks the same when turned


def rows_of(chain: Chain) -> list[dict[str, float]]:
    return [
        {
            "a_mm": j.a_mm,
            "alpha_deg": math.degrees(j.alpha_rad),
            "d_mm": j.d_mm,
            "theta_offset_deg": math.degrees(j.theta_offset_rad),
        }
        for j in chain.joints
    ]


def make_robot(api: Any, chain: Chain = KR5_ARC) -> str:
    response = api.client.post("/v1/robots", json={"name": "KR5", "joints": rows_of(chain)})
    assert response.status_code == 201, response.text
    return str(response.json()["id"])


def measured(seed: int = 1, *, arc_deg: float = 40.0, free: int = 20, **options: Any) -> tuple[Arm, PoseData]:
    """A KR5 as built, swept joint by joint and moved freely, and what a laser tracker reads of it."""
    rng = np.random.default_rng(seed)
    arm = kr5_arc(rng)
    q = sweep_angles(KR5_ARC_HOME, half_arc=math.radians(arc_deg), steps=9)
    q = np.concatenate([q, free_angles(rng, KR5_ARC_HOME, free)])
    return arm, measure_poses(arm, q, rng, estimator="given", robot=ROBOT, **options)


def readings(poses: PoseData, **changes: Any) -> list[dict[str, Any]]:
    assert poses.rotations is not None
    assert poses.covariance is not None
    return [
        {
            "pose_id": poses.label(i),
            "cycle": 1,
            "joint_angles_deg": np.degrees(poses.joint_angles[i]).tolist(),
            "position_mm": poses.positions_mm[i].tolist(),
            "rotation": poses.rotations[i].tolist(),
            "covariance": poses.covariance[i].tolist(),
            **changes,
        }
        for i in range(len(poses))
    ]


def send(api: Any, session: str, sent: list[dict[str, Any]]) -> list[str]:
    response = api.client.post(f"/v1/sessions/{session}/measured-poses", json=sent)
    assert response.status_code == 200, response.text
    return [item["id"] for item in response.json()["items"]]


def get(api: Any, session: str, **query: Any) -> Any:
    return api.client.get(f"/v1/sessions/{session}/dh", params=query)


def of_readings(api: Any, session: str, **query: Any) -> Any:
    return get(api, session, source="measured_poses", **query)


def document(response: Any) -> dict[str, Any]:
    """The document, checked for what every one of them keeps."""
    found = body(response)
    DhAnalysis.model_validate(found, extra="forbid")
    assert found["convention"] == "classic_dh"
    assert [j["joint"] for j in found["joints"]] == list(range(1, len(found["joints"]) + 1))
    for joint in found["joints"]:
        for name, told in joint["identifiable"].items():
            assert (joint["standard_uncertainty"][name] is not None) == told
        assert (joint["beta_deg"] is not None) == joint["parallel_to_next"]
        if joint["nominal"] is not None:
            for name in NAMES:
                assert joint["identifiable"][name] or joint[name] == pytest.approx(joint["nominal"][name])
    size = len(found["parameters"])
    assert np.array(found["correlation"]).shape == (size, size)
    assert found["null_space"]
    return found


def chain_of(found: dict[str, Any]) -> Chain:
    return Chain.from_array(
        np.array(
            [
                [
                    j["a_mm"],
                    math.radians(j["alpha_deg"]),
                    j["d_mm"],
                    math.radians(j["theta_offset_deg"]),
                    math.radians(j["beta_deg"] or 0.0),
                ]
                for j in found["joints"]
            ]
        )
    )


def error_mm(found: dict[str, Any], arm: Arm, q: Any, target: int = 0) -> float:
    """Rms distance, over configurations, of where the camera is said to be from where it was."""
    T = np.array(found["T_target_base"][target]) @ forward(chain_of(found), q)
    T = T @ np.array(found["T_flange_camera"])
    true = arm.camera_poses(q, np.full(len(q), target))
    return float(np.sqrt(np.mean(np.sum((T[:, :3, 3] - true[:, :3, 3]) ** 2, axis=1))))


def nominal_error_mm(found: dict[str, Any], arm: Arm, q: Any) -> float:
    """The nominal robot's, its base and tool where they were found."""
    T = np.array(found["T_target_base"][0]) @ forward(KR5_ARC, q) @ np.array(found["T_flange_camera"])
    return float(np.sqrt(np.mean(np.sum((T[:, :3, 3] - arm.camera_poses(q)[:, :3, 3]) ** 2, axis=1))))


def test_all_poses_at_once_find_the_robot(api: Any) -> None:
    arm, poses = measured(1)
    session = new_session(api, robot_id=make_robot(api))
    send(api, session, readings(poses))
    found = document(of_readings(api, session))
    assert (found["method"], found["source"], found["estimator"], found["pending"]) == (
        "global",
        "measured_poses",
        "pooled",
        0,
    )
    others = free_angles(np.random.default_rng(99), KR5_ARC_HOME, 50)
    assert error_mm(found, arm, others) < 0.2 < nominal_error_mm(found, arm, others)
    # What does not hang on conventions lies within its doubt.
    true = rows_of(arm.chain)
    scores = [
        (found["joints"][i][name] - true[i][name]) / found["joints"][i]["standard_uncertainty"][name]
        for i in range(5)
        for name in ("a_mm", "alpha_deg")
        if not found["joints"][i]["parallel_to_next"]
    ]
    assert len(scores) == 8
    assert float(np.sqrt(np.mean(np.square(scores)))) < 2.0
    validation = found["validation"]
    assert validation["held_out"] == len(poses)
    assert validation["position_rms_mm"] < 0.7 * validation["nominal"]["position_rms_mm"]
    assert found["robot_scatter"]["position_mm"] == pytest.approx(0.05, rel=0.3)
    assert 1.0 < found["condition_number"] < 1000.0
    assert all(j["residual"]["position_rms_mm"] < 0.3 for j in found["joints"])
    assert [round(j["arc_deg"]) for j in found["joints"]] == [80] * 6
    joint2 = found["joints"][1]
    assert (joint2["parallel_to_next"], joint2["identifiable"]["d_mm"]) == (True, False)
    assert any("base" in sentence for sentence in found["null_space"])


@pytest.mark.parametrize(("method", "within_mm"), [("cpa", 2.0), ("screw", 0.6), ("combined", 0.3)])
def test_axes_of_sweeps_find_the_robot(api: Any, method: str, within_mm: float) -> None:
    arm, poses = measured(2, free=0)
    session = new_session(api, robot_id=make_robot(api))
    send(api, session, readings(poses))
    found = document(of_readings(api, session, method=method))
    assert found["method"] == method
    assert error_mm(found, arm, free_angles(np.random.default_rng(99), KR5_ARC_HOME, 50)) < within_mm
    validation = found["validation"]
    assert (validation["held_out"], validation["left_out"]) == (len(poses), 0)
    if method != "cpa":
        assert validation["position_rms_mm"] < validation["nominal"]["position_rms_mm"]
    assert [j["poses"] for j in found["joints"]] == [14] * 6  # its own nine, and home from the other five
    assert all(j["residual"]["position_rms_mm"] < 0.3 for j in found["joints"])


def test_without_a_nominal_the_sweeps_are_the_start(api: Any) -> None:
    arm, poses = measured(3, free=6)
    session = new_session(api)
    send(api, session, readings(poses))
    found = document(of_readings(api, session))
    assert all(joint["nominal"] is None for joint in found["joints"])
    assert found["validation"]["nominal"] is None
    assert error_mm(found, arm, free_angles(np.random.default_rng(99), KR5_ARC_HOME, 50)) < 0.3


def test_positions_alone_tell_what_they_can(api: Any) -> None:
    _, poses = measured(4)
    session = new_session(api, robot_id=make_robot(api))
    send(api, session, readings(poses, rotation=None))
    for method in ("global", "cpa", "combined"):
        found = document(of_readings(api, session, method=method))
        assert found["residual"]["rotation_rms_deg"] is None
        assert found["robot_scatter"]["rotation_deg"] is None
    problem(of_readings(api, session, method="screw"), 409, "rotations_missing")


def test_the_order_of_sending_and_ids_never_matter(api: Any) -> None:
    _, poses = measured(5, free=4)
    sent = readings(poses)
    shuffled = list(sent)
    random.Random(4).shuffle(shuffled)
    robot = make_robot(api)
    session, other = new_session(api, robot_id=robot), new_session(api, robot_id=make_robot(api))
    send(api, session, sent)
    for start in range(0, len(sent), 17):
        send(api, other, shuffled[start : start + 17])
    for method in ("global", "combined"):
        first, second = (of_readings(api, one, method=method) for one in (session, other))
        assert body(first)["inputs_sha256"] == body(second)["inputs_sha256"]
        assert same_but_for_ids(first.text, [session], second.text, [other])
    url = f"/v1/sessions/{session}/dh"
    query = {"source": "measured_poses", "method": "combined"}
    known = {"If-None-Match": of_readings(api, session, method="combined").headers["ETag"]}
    assert api.client.get(url, params=query, headers=known).status_code == 304
    # What it is computed from: tolerance and robot are part of it.
    wider = api.client.get(url, params={**query, "joint_tolerance_deg": 0.05}, headers=known)
    assert body(wider)["joint_tolerance_deg"] == 0.05
    changed = dataclasses.replace(KR5_ARC.joints[2], a_mm=121.0)
    deviating = make_robot(api, Chain((*KR5_ARC.joints[:2], changed, *KR5_ARC.joints[3:])))
    assert api.client.patch(f"/v1/sessions/{session}", json={"robot_id": deviating}).status_code == 200
    assert api.client.get(url, params=query, headers=known).status_code == 200


def test_refusals_say_what_to_do(api: Any) -> None:
    robot = make_robot(api)
    _, poses = measured(6, free=4)
    sent = readings(poses)

    def refused(
        readings: list[dict[str, Any]], code: str, *, robot_id: str | None = robot, **query: Any
    ) -> str:
        session = new_session(api, robot_id=robot_id)
        send(api, session, readings)
        found = problem(of_readings(api, session, **query), 409, code)
        assert found["advice"]
        return str(found["detail"])

    assert refused([{**r, "joint_angles_deg": None} for r in sent], "joint_angles_missing")
    problem(of_readings(api, new_session(api)), 409, "measured_poses_missing")
    # The robot was changed after the readings came.
    session = new_session(api)
    send(api, session, sent)
    five = make_robot(api, Chain(KR5_ARC.joints[:5]))
    assert api.client.patch(f"/v1/sessions/{session}", json={"robot_id": five}).status_code == 200
    assert "5" in problem(of_readings(api, session), 409, "joint_angles_inconsistent")["detail"]
    # Radians by mistake; and a joint that does not turn.
    radians = [{**r, "joint_angles_deg": np.radians(r["joint_angles_deg"]).tolist()} for r in sent]
    for method in ("global", "combined"):
        assert "radians" in refused(radians, "joint_angles_unit", method=method)
    # Without sweeps the nominal robot tells, of positions alone too.
    _, loose = measured(6, arc_deg=40.0, free=40)
    free = readings(loose)[54:]
    for changes in ({}, {"rotation": None}):
        radians = [
            {**r, **changes, "joint_angles_deg": np.radians(r["joint_angles_deg"]).tolist()} for r in free
        ]
        assert "radians" in refused(radians, "joint_angles_unit")
    _, short = measured(6, arc_deg=20.0, free=0)
    assert "60°" in refused(readings(short), "arc_too_short", method="cpa")
    still = [r for i, r in enumerate(sent[:54]) if not 27 <= i < 36]
    for method in ("global", "combined", "cpa"):
        assert "4" in refused(still, "joint_not_moved", method=method)
    sliding = [
        {
            **r,
            "joint_angles_deg": [*KR5_ARC_HOME[:5].tolist(), 10.0 * i],
            "position_mm": [100.0 * i, 0.0, 0.0],
            "rotation": np.eye(3).tolist(),
        }
        for i, r in enumerate(sent[:9])
    ]
    refused(sliding, "prismatic_joint", method="combined")
    refused(sent[:5], "joint_not_moved")


def test_sweeps_named_by_their_poses(api: Any) -> None:
    """Free poses that happen to rest do not disturb, a pose serves several sweeps, patterns stand for many."""
    arm, poses = measured(7, free=6)
    joints = [np.flatnonzero(np.ptp(poses.joint_angles[9 * k : 9 * k + 9], axis=0) > 0.1) for k in range(6)]
    assert [j.tolist() for j in joints] == [[k] for k in range(6)]
    names = [f"j{i // 9 + 1}-{i % 9}" if i < 54 else f"free.{i - 54}" for i in range(len(poses))]
    sent = [{**r, "pose_id": name} for r, name in zip(readings(poses), names, strict=True)]
    session = new_session(api, robot_id=make_robot(api))
    send(api, session, sent)
    plain = document(of_readings(api, session, method="combined"))
    assert plain["sweeps"] == []
    assert [j["poses"] for j in plain["joints"]] == [14] * 6
    named = document(of_readings(api, session, method="combined", sweep=[f"{k}:j{k}-*" for k in range(1, 7)]))
    assert [j["poses"] for j in named["joints"]] == [9] * 6
    assert error_mm(named, arm, free_angles(np.random.default_rng(99), KR5_ARC_HOME, 50)) < 0.3
    # Home, the fifth of each sweep, may serve any of them; what is not named is recognised; order is of no matter.
    some = ["3:j3-1,j3-0,j3-8,j1-4,j3-7", "1:j1-?"]
    first, second = (
        of_readings(api, session, method="combined", sweep=order) for order in (some, some[::-1])
    )
    assert first.content == second.content
    found = document(first)
    assert found["sweeps"] == ["1:j1-?", "3:j1-4,j3-0,j3-1,j3-7,j3-8"]
    assert [j["poses"] for j in found["joints"]] == [9, 14, 5, 14, 14, 14]
    # Two sweeps of one joint, and the global method's residuals by joint.
    found = document(of_readings(api, session, sweep=["2:j2-0,j2-1,j2-2,j2-3", "2:j2-4,j2-5,j2-6,j2-7,j2-8"]))
    assert found["inputs_sha256"] != document(of_readings(api, session))["inputs_sha256"]
    assert found["joints"][1]["residual"]["position_rms_mm"] < 0.3

    def refused(code: str, *sweep: str) -> str:
        answer = problem(of_readings(api, session, method="combined", sweep=list(sweep)), 409, code)
        assert answer["advice"]
        return str(answer["detail"])

    assert "j9-1" in refused("sweep_pose_unknown", "1:j1-1,j9-1")
    assert "x*" in refused("sweep_pose_unknown", "1:x*")
    assert "*j*" in refused("sweep_pose_unknown", f"1:{'*j' * 40}*x")  # at once, however many stars
    assert "7" in refused("sweep_joint_unknown", "7:j1-*")
    assert "joint 2 moved" in refused("joint_angles_inconsistent", "1:j1-*,j2-0")
    assert "joint 2 moved" in refused("joint_angles_inconsistent", "1:j2-*")
    refused("joint_not_moved", "1:j1-1,j1-2")
    for malformed in ("", "j1-1", "0:j1-1", "1:", "1:a,,b", "100:a", "1:a b", "1:[a]", "1:ü"):
        assert of_readings(api, session, sweep=malformed).status_code == 422, malformed
    # A wider tolerance lets the others move by so much.
    document(of_readings(api, session, method="combined", sweep="1:j1-*", joint_tolerance_deg=1.0))


def test_poses_that_failed_are_left_out_of_a_named_sweep(api: Any) -> None:
    _, poses = measured(8, free=0)
    sent = [{**r, "pose_id": f"p{i}"} for i, r in enumerate(readings(poses))]
    sent[3]["joint_angles_deg"] = None
    session = new_session(api, robot_id=make_robot(api))
    send(api, session, sent)
    sweep = "1:" + ",".join(f"p{i}" for i in range(9))
    found = document(of_readings(api, session, method="combined", sweep=sweep))
    assert found["joints"][0]["poses"] == 8
    (said,) = (w for w in found["warnings"] if w["code"] == "sweep_poses_left_out")
    assert "p3" in said["detail"]


def test_queries_are_checked(api: Any) -> None:
    session = new_session(api)
    for query in (
        {"method": "paper"},
        {"joint_tolerance_deg": "0"},
        {"joint_tolerance_deg": "nan"},
        {"joint_tolerance_deg": "inf"},
        {"joint_tolerance_deg": "6"},
        {"joint_tolerance_deg": "x"},
        {"source": "robot"},
        {"estimator": "mine"},
    ):
        assert get(api, session, **query).status_code == 422, query
    problem(get(api, session), 409, "too_few_measurements")
    problem(get(api, "ses_nothing"), 404, "session_not_found")


def photographed(
    seed: int, boards: list[TargetSpec], *, arc_deg: float = 8.0, free: int = 12
) -> tuple[Arm, list[list[Shot]], Any]:
    """A KR5 whose camera sees boards from its flange: what a detector found in every image, board by board."""
    rng = np.random.default_rng(seed)
    arm = kr5_arc(rng)
    at_home = forward(arm.chain, KR5_ARC_HOME[None])[0] @ arm.T_flange_camera
    bases = [
        invert(draw_pose(rng, board, CAMERA, WIDTH, math.radians(25.0))) @ invert(at_home) for board in boards
    ]
    arm = Arm(arm.chain, np.array(bases), arm.T_flange_camera)
    q = sweep_angles(KR5_ARC_HOME, half_arc=math.radians(arc_deg), steps=5)
    q = np.concatenate([q, free_angles(rng, KR5_ARC_HOME, free, half_range=math.radians(arc_deg))])
    T = [arm.camera_poses(q, np.full(len(q), index)) for index in range(len(boards))]
    seen = [[look(rng, invert(pose), board=board) for pose in T[k]] for k, board in enumerate(boards)]
    shown = [i for i in range(len(q)) if all(_near_the_picture(views[i]) for views in seen)]
    shots = [
        [Shot(f"P{n + 1}", None, seen[k][i], T[k][i]) for n, i in enumerate(shown)]
        for k in range(len(boards))
    ]
    return arm, shots, q[shown]


def _near_the_picture(points: GridPoints) -> bool:
    """Whether the board is where a wider picture would show it; beyond, the lens's model bends back on itself."""
    size = np.array([points.image_width_px, points.image_height_px])
    return bool(np.all(points.points_px >= -size) and np.all(points.points_px <= 2.0 * size))


def tell_angles(api: Any, session: str, q: Any) -> None:
    told = [
        {"pose_id": f"P{i + 1}", "joint_angles_deg": np.degrees(angles).tolist()}
        for i, angles in enumerate(q)
    ]
    assert api.client.post(f"/v1/sessions/{session}/poses", json=told).status_code == 200


@pytest.mark.parametrize(
    ("board", "estimator"), [(BOARD, "pooled"), (EVEN, "pooled"), (BOARD, "given"), (BOARD, "per_image")]
)
def test_images_find_the_robot(api: Any, store: Store, board: TargetSpec, estimator: str) -> None:
    arm, (shots,), q = photographed(11, [board])
    session = new_session(api, board, robot_id=make_robot(api), intrinsics=dataclasses.asdict(CAMERA))
    tell_angles(api, session, q)
    store(api, session, shots)
    found = document(get(api, session, estimator=estimator))
    assert (found["source"], found["estimator"]) == ("images", estimator)
    assert "identified_from_poses" not in [w["code"] for w in found["warnings"]]
    # The robot is perfect here; each image by itself is worse by far (METHOD, section 4).
    assert error_mm(found, arm, q) < (1.0 if estimator == "per_image" else 0.05)


def test_an_image_s_own_angles_override_its_pose_s(api: Any, store: Store) -> None:
    arm, (shots,), q = photographed(12, [BOARD], free=4)
    session = new_session(api, robot_id=make_robot(api))
    wrong = q + np.radians(np.random.default_rng(1).uniform(2.0, 5.0, q.shape))
    tell_angles(api, session, wrong)
    own = [
        dataclasses.replace(shot, fields={"joint_angles_deg": np.degrees(angles).tolist()})
        for shot, angles in zip(shots, q, strict=True)
    ]
    store(api, session, own)
    assert error_mm(document(get(api, session)), arm, q) < 0.1


def test_images_without_angles_are_left_out_and_named(api: Any, store: Store) -> None:
    arm, (shots,), q = photographed(13, [BOARD], free=6)
    session = new_session(api, robot_id=make_robot(api))
    store(api, session, shots)
    problem(get(api, session), 409, "joint_angles_missing")
    tell_angles(api, session, q[:-1])
    found = document(get(api, session))
    (remark,) = (w for w in found["warnings"] if w["code"] == "joint_angles_missing")
    assert f"P{len(q)}" in remark["detail"]
    assert error_mm(found, arm, q) < 0.1


@pytest.mark.parametrize("method", ["global", "combined"])
def test_two_targets_in_one_session(api: Any, store: Store, method: str) -> None:
    """Sweeps of some joints seen on one board, of the others on the other, and some images of both."""
    arm, (first, second), q = photographed(14, [BOARD, OTHER], free=8)
    session = new_session(api, BOARD, OTHER, robot_id=make_robot(api))
    targets = api.client.get(f"/v1/sessions/{session}").json()["target_ids"]
    tell_angles(api, session, q)
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


def test_roll_pitch_yaw_of_the_commands_are_not_needed(api: Any, store: Store) -> None:
    """A board that looks the same when turned is read by the nominal robot's orientations."""
    _, (shots,), q = photographed(15, [EVEN], free=6)
    turned = []
    for i, shot in enumerate(shots):
        points = shot.points
        assert points is not None
        points = dataclasses.replace(points, origin="turned")
        if i % 3 == 0:  # as a detector would name them in an image that is turned past the vertical
            points = dataclasses.replace(
                points, column=EVEN.columns - 1 - points.column, row=EVEN.rows - 1 - points.row
            )
        turned.append(dataclasses.replace(shot, points=points))
    session = new_session(api, EVEN, robot_id=make_robot(api))
    tell_angles(api, session, q)
    store(api, session, turned)
    found = document(get(api, session))
    assert found["residual"]["position_rms_mm"] < 0.1
    other = new_session(api, EVEN, robot_id=make_robot(api))
    tell_angles(api, other, q)
    store(api, other, shots)
    plain = document(get(api, other))
    # The frame is the first image's reading in both; the robot is the same one.
    for one, two in zip(found["joints"], plain["joints"], strict=True):
        assert one["a_mm"] == pytest.approx(two["a_mm"], abs=1e-3)


UR10 = Chain.from_rows(
    [
        (0.0, 90.0, 127.3, 0.0),
        (-612.0, 0.0, 0.0, 0.0),
        (-572.3, 0.0, 0.0, 0.0),
        (0.0, 90.0, 163.941, 0.0),
        (0.0, -90.0, 115.7, 0.0),
        (0.0, 0.0, 92.2, 0.0),
    ]
)
"""By the maker's data sheet."""


def imported(path: Path, joints: str, **layout: Any) -> list[dict[str, Any]]:
    columns = {"joints": joints, **layout.pop("columns")}
    found, problems = read_readings(
        read_records(path, None, None), Layout(columns=columns, joint_deg=math.degrees(1.0), **layout)
    )
    assert problems == []
    return [reading for _, reading in found]


def test_a_real_robot_before_a_laser_tracker(api: Any, data_folder: Path) -> None:
    """ipa-robot-accuracy (MIT): 1,495 poses of a UR10 that its maker's data sheet misses by a millimetre."""
    axes = ("x", "y", "z", "rx", "ry", "rz")
    columns = {axis: f"measurement_{axis}" for axis in axes}
    columns |= {f"u_{axis}": f"measurement_std_{axis}" for axis in axes}
    sent = imported(
        data_folder / "ur10_lasertracker" / "Series_B" / "measurements_joint_configurations.csv",
        "shoulder_pan_joint,shoulder_lift_joint,elbow_joint,wrist_1_joint,wrist_2_joint,wrist_3_joint",
        columns=columns,
        rotation="xyz",
    )
    session = new_session(api, robot_id=make_robot(api, UR10))
    send(api, session, sent)
    found = document(of_readings(api, session))
    validation = found["validation"]
    assert (len(sent), validation["held_out"]) == (1495, 1495)
    # Every pose is predicted by an identification that it had no part in.
    assert validation["position_rms_mm"] < 0.6 * validation["nominal"]["position_rms_mm"]
    assert validation["rotation_rms_deg"] < 0.75 * validation["nominal"]["rotation_rms_deg"]
    for joint in found["joints"]:
        for name, nearness in (("a_mm", 3.0), ("d_mm", 3.0), ("alpha_deg", 0.2), ("theta_offset_deg", 0.2)):
            assert abs(joint[name] - joint["nominal"][name]) < nearness
    assert [joint["parallel_to_next"] for joint in found["joints"]] == [False, True, True] + [False] * 3
    problem(of_readings(api, session, method="combined"), 409, "joint_not_moved")


def test_a_real_positioner_before_a_camera(api: Any, data_folder: Path) -> None:
    """robot_cal_tools (Apache-2.0): two axes that cross at right angles, by 205 poses of a target on the turntable."""
    columns = {name: f"pose.{name}" for name in ("x", "y", "z", "qx", "qy", "qz", "qw")}
    sent = imported(
        data_folder / "robot_cal_tools" / "positioner_kinematic_measurements.yaml",
        "target_joints",
        columns=columns,
        length_mm=1000.0,
    )
    session = new_session(api)
    send(api, session, sent)
    first = document(of_readings(api, session, joint_tolerance_deg=0.2))["joints"][0]
    # How they lie is not published; that they are within a millimetre and a tenth of a degree of crossing at right
    # angles is what the makers of positioners aim at.
    assert abs(first["a_mm"]) < 1.0
    assert abs(abs(first["alpha_deg"]) - 90.0) < 0.1
    assert first["standard_uncertainty"]["a_mm"] < 0.2
