"""Accuracy against mixed commands: every pose is compared as far as its command allows, or named."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from core.geometry.se3 import invert, transform
from core.targets.specification import TargetSpec
from tests.support.sessions.repeatability import command, deviating_robot
from tests.support.sessions.stored_sessions import Shot, Store, body, look, new_session
from tests.support.sessions.tracked_robot import drawn_poses, readings, send, send_commands


def table(api: Any, session: str, **query: str) -> dict[str, Any]:
    return body(api.client.get(f"/v1/sessions/{session}/repeatability", params=query))


def accuracy_of(document: dict[str, Any]) -> dict[str, Any]:
    return {row["pose_id"]: row["accuracy"] for row in document["poses"]}


def warning_detail(document: dict[str, Any], code: str) -> str:
    (warning,) = [w for w in document["warnings"] if w["code"] == code]
    assert warning["advice"]
    return str(warning["detail"])


def send_positions(api: Any, session: str, poses: list[Any], first: int) -> None:
    """Command the positions alone of all poses from that index on."""
    for k, pose in enumerate(poses[first:], first + 1):
        fields = {"position_mm": pose[:3, 3].tolist()}
        assert api.client.put(f"/v1/sessions/{session}/poses/P{k}", json=fields).status_code == 201


def errors(found: dict[str, Any], off: dict[str, Any], names: list[str]) -> float:
    """Root mean square difference of AP by axis from what the robot was truly off."""
    reported = np.array([[found[name][f"ap_{axis}_mm"] for axis in "xyz"] for name in names])
    return float(np.sqrt(np.mean((reported - np.array([off[name] for name in names])) ** 2)))


@pytest.mark.slow
@pytest.mark.parametrize("without", [6, 16])
def test_poses_whose_position_alone_was_commanded_are_compared_too(
    api: Any, store: Store, without: int
) -> None:
    """In the frames that the others tie, be these most or few of the poses."""
    shots, commanded, off = deviating_robot(15, 24, 0.5)
    session = new_session(api)
    store(api, session, shots)
    names = list(commanded)
    command(api, session, {name: commanded[name] for name in names[without:]})
    command(api, session, {name: commanded[name] for name in names[:without]}, angles=False)
    document = table(api, session)
    found = accuracy_of(document)
    assert None not in found.values()
    assert errors(found, off, names) < 0.35
    assert {w["code"] for w in document["warnings"]}.isdisjoint(
        {"accuracy_incomplete", "accuracy_unavailable", "orientation_accuracy_unavailable"}
    )
    assert [name for name in names if found[name]["ap_yaw_deg"] is not None] == names[without:]


@pytest.mark.slow
def test_two_commanded_orientations_do_not_keep_the_others_from_being_compared(
    api: Any, store: Store
) -> None:
    shots, commanded, off = deviating_robot(18, 12, 0.3)
    session = new_session(api)
    store(api, session, shots)
    names = list(commanded)
    command(api, session, {name: commanded[name] for name in names[:2]})
    command(api, session, {name: commanded[name] for name in names[2:]}, angles=False)
    document = table(api, session)
    found = accuracy_of(document)
    assert None not in found.values()
    assert errors(found, off, names) < 0.35
    detail = warning_detail(document, "orientation_accuracy_unavailable")
    assert f"{names[0]}, {names[1]} have no accuracy of orientation" in detail
    assert "fewer than half of the poses, and than 6" in detail


@pytest.mark.slow
@pytest.mark.parametrize(("whole", "positions"), [(6, 8), (10, 12)])
def test_many_commanded_positions_do_not_keep_few_whole_poses_from_being_compared(
    api: Any, store: Store, whole: int, positions: int
) -> None:
    """Of either source: the whole ones with their orientation, the others in the frames these tie."""
    shots, commanded, off = deviating_robot(21, whole + positions, 0.3)
    session = new_session(api)
    store(api, session, shots)
    names = list(commanded)
    command(api, session, {name: commanded[name] for name in names[:whole]})
    command(api, session, {name: commanded[name] for name in names[whole:]}, angles=False)
    by_images = table(api, session)
    found = accuracy_of(by_images)
    assert None not in found.values()
    assert errors(found, off, names) < 0.4
    assert [name for name in names if found[name]["ap_yaw_deg"] is not None] == names[:whole]

    poses = drawn_poses(6, whole + positions)
    session = new_session(api)
    send_commands(api, session, poses[:whole])
    send_positions(api, session, poses, whole)
    send(api, session, readings(poses, cycles=3))
    by_probe = table(api, session, source="measured_poses")
    found = accuracy_of(by_probe)
    assert None not in found.values()
    assert max(one["ap_p_mm"] for one in found.values()) < 0.5
    assert {name for name, one in found.items() if one["ap_yaw_deg"] is not None} == {
        f"P{k}" for k in range(1, whole + 1)
    }
    for document in (by_images, by_probe):
        assert {w["code"] for w in document["warnings"]}.isdisjoint(
            {"accuracy_incomplete", "accuracy_unavailable", "orientation_accuracy_unavailable"}
        )


def test_readings_with_orientation_serve_commanded_positions_alone(api: Any) -> None:
    """Three whole poses of twelve tie too little: the probe's own orientations determine its tip."""
    poses = drawn_poses(7, 12)
    session = new_session(api)
    send_commands(api, session, poses[:3])
    send_positions(api, session, poses, 3)
    send(api, session, readings(poses, cycles=3))
    document = table(api, session, source="measured_poses")
    found = accuracy_of(document)
    assert None not in found.values()
    assert max(one["ap_p_mm"] for one in found.values()) < 0.5
    assert "tool_offset_unknown" not in {w["code"] for w in document["warnings"]}
    assert "P1, P2, P3 have no accuracy" in warning_detail(document, "orientation_accuracy_unavailable")


def test_reflectors_that_were_commanded_a_position_alone_do_not_spoil_the_others(api: Any) -> None:
    poses = drawn_poses(8, 16)
    session = new_session(api)
    send_commands(api, session, poses[:10])
    send_positions(api, session, poses, 10)
    sent = readings(poses, cycles=3)
    for reading in sent:
        reading["rotation"] = None
    send(api, session, sent)
    document = table(api, session, source="measured_poses")
    found = accuracy_of(document)
    assert {name for name, one in found.items() if one is None} == {f"P{k}" for k in range(11, 17)}
    assert max(one["ap_p_mm"] for one in found.values() if one) < 0.5
    assert "its orientation was not commanded" in warning_detail(document, "accuracy_incomplete")


@pytest.mark.slow
def test_poses_before_a_second_target_are_tied_by_themselves_or_named(api: Any, store: Store) -> None:
    second = TargetSpec("chessboard", 8, 5, 12.0)
    shots, commanded, off = deviating_robot(19, 20, 0.3)
    there = transform(np.eye(3), np.array([40.0, 0.0, 0.0]))
    for count, complete in ((8, True), (1, False)):
        names = list(commanded)[-count:]
        rng = np.random.default_rng(4)
        session = new_session(api, look(rng, invert(shots[0].T_target_camera)).target, second)
        first_id, second_id = api.client.get(f"/v1/sessions/{session}").json()["target_ids"]
        store(api, session, [shot for shot in shots if shot.pose_id not in names], first_id)
        others = [
            # The same cameras; of the second target, which stands 40 mm along x in the first's frame.
            dataclasses.replace(shot, points=look(rng, invert(shot.T_target_camera) @ there, board=second))
            for shot in shots
            if shot.pose_id in names
        ]
        store(api, session, others, second_id)
        command(api, session, commanded)
        document = table(api, session)
        found = accuracy_of(document)
        if complete:
            assert errors(found, off, list(commanded)) < 0.4
            assert "accuracy_incomplete" not in {w["code"] for w in document["warnings"]}
        else:
            assert {name for name, one in found.items() if one is None} == set(names)
            detail = warning_detail(document, "accuracy_incomplete")
            assert detail.startswith("One pose has a commanded position and no accuracy.")
            assert names[0] in detail


def test_a_pose_none_of_whose_images_counts_is_named(api: Any, store: Store) -> None:
    shots, commanded, _ = deviating_robot(20, 12, 0.3)
    session = new_session(api)
    blind = [
        Shot(shot.pose_id, shot.cycle, None, shot.T_target_camera) for shot in shots if shot.pose_id == "P3"
    ]
    store(api, session, [*(shot for shot in shots if shot.pose_id != "P3"), *blind])
    command(api, session, commanded)
    document = table(api, session)
    assert accuracy_of(document)["P3"] is None
    assert "P3: no measurement of it counts" in warning_detail(document, "accuracy_incomplete")


def test_readings_with_and_without_orientation(api: Any) -> None:
    """A probe at most poses and a reflector at two: these two cannot be compared with the others, and are named."""
    poses = drawn_poses(4, 12)
    session = new_session(api)
    send_commands(api, session, poses)
    sent = readings(poses, cycles=3)
    for reading in sent:
        if reading["pose_id"] in ("P5", "P10"):
            reading["rotation"] = None
    send(api, session, sent)
    document = table(api, session, source="measured_poses")
    found = accuracy_of(document)
    assert {name for name, one in found.items() if one is None} == {"P5", "P10"}
    assert "P5, P10: not all of its readings" in warning_detail(document, "accuracy_incomplete")
    # Commanded positions alone are enough where the reading has an orientation.
    session = new_session(api)
    send_commands(api, session, poses)
    fields = {"position_mm": poses[4][:3, 3].tolist()}
    assert api.client.put(f"/v1/sessions/{session}/poses/P5", json=fields).status_code == 200
    send(api, session, readings(poses, cycles=3))
    found = accuracy_of(table(api, session, source="measured_poses"))
    assert None not in found.values()
    assert found["P5"]["ap_p_mm"] < 0.5
    assert found["P5"]["ap_yaw_deg"] is None
