"""Robots, sessions and poses: made, read, changed, listed, deleted; on both databases."""

from __future__ import annotations

from typing import Any

from app.api.schemas.poses import MAX_POSES

ROBOT: dict[str, Any] = {
    "name": "KR5",
    "joints": [{"a_mm": 180, "alpha_deg": -90, "d_mm": 400, "theta_offset_deg": 0}],
    "datasheet_repeatability_mm": 0.04,
}


def test_a_robot_is_read_as_it_was_made(any_api: Any) -> None:
    made = any_api.client.post("/v1/robots", json=ROBOT)
    assert made.status_code == 201
    document = made.json()
    stated = {"manufacturer", "model", "serial_number", "datasheet_repeatability_mm", "datasheet_accuracy_mm"}
    assert set(document) == {"id", "name", "joints", "joint_coupling"} | stated
    assert document["serial_number"] is None
    unknown = {"beta_deg": None, "name": None, "minimum_deg": None, "maximum_deg": None}
    assert document["joints"] == [{**joint, **unknown} for joint in ROBOT["joints"]]
    assert any_api.client.get(made.headers["location"]).json() == document


def test_a_session_holds_what_it_was_made_with(any_api: Any) -> None:
    target_id = any_api.make_target()
    robot_id = any_api.client.post("/v1/robots", json=ROBOT).json()["id"]
    made = any_api.client.post(
        "/v1/sessions",
        json={
            "name": "cell 4",
            "target_ids": [target_id],
            "robot_id": robot_id,
            "lens": {"focal_length_mm": 8, "pixel_pitch_um": 3.45},
            "intrinsics": {"fx_px": 2320, "fy_px": 2320, "cx_px": 1224, "cy_px": 1025},
            "conditions": {"temperature_c": 21.5, "operator": "A. Tester"},
        },
    )
    assert made.status_code == 201, made.text
    document = made.json()
    unstated = dict.fromkeys(("load_kg", "speed_percent", "warm_up_min", "notes"))
    assert document["conditions"] == {"temperature_c": 21.5, "operator": "A. Tester", **unstated}
    assert document["target_ids"] == [target_id]
    assert document["robot_id"] == robot_id
    assert document["lens"] == {"focal_length_mm": 8.0, "pixel_pitch_um": 3.45}
    assert document["intrinsics"]["k1"] == 0.0
    assert document["counts"] == {
        "queued": 0,
        "running": 0,
        "succeeded": 0,
        "failed": 0,
        "duplicates": 0,
    }
    assert any_api.client.get(made.headers["location"]).json() == document


def test_patch_changes_what_is_named_and_nothing_else(any_api: Any) -> None:
    first, second = any_api.make_target(), any_api.make_target(name="second")
    session_id = any_api.make_session(first, lens={"focal_length_mm": 8, "pixel_pitch_um": 3.45})
    before = any_api.client.get(f"/v1/sessions/{session_id}").json()

    assert any_api.client.patch(f"/v1/sessions/{session_id}", json={}).json() == before
    changed = any_api.client.patch(
        f"/v1/sessions/{session_id}", json={"name": "new", "target_ids": [second, first], "lens": None}
    )
    assert changed.status_code == 200, changed.text
    expected = {**before, "name": "new", "target_ids": [second, first], "lens": None}
    assert changed.json() == expected
    stated = {"conditions": {"load_kg": 3.2}}
    assert (
        any_api.client.patch(f"/v1/sessions/{session_id}", json=stated).json()["conditions"]["load_kg"] == 3.2
    )
    assert any_api.client.patch(f"/v1/sessions/{session_id}", json={"conditions": None}).json() == expected
    assert any_api.client.get(f"/v1/sessions/{session_id}").json() == expected


def test_a_session_refuses_targets_and_robots_that_do_not_exist(api: Any) -> None:
    target_id = api.make_target()
    for fields, code in (
        ({"target_ids": ["tgt_nope"]}, "referenced_target_not_found"),
        ({"target_ids": [target_id, target_id]}, "invalid_request"),
        ({"target_ids": [target_id], "robot_id": "rob_nope"}, "referenced_robot_not_found"),
    ):
        response = api.client.post("/v1/sessions", json={"name": "s", **fields})
        assert (response.status_code, response.json()["code"]) == (422, code)


def test_poses_are_made_replaced_and_listed(any_api: Any) -> None:
    address = f"/v1/sessions/{any_api.make_session()}/poses"
    pose = {"position_mm": [1, 2.5, -3], "roll_deg": 180, "joint_angles_deg": [0, -90.5], "approach": "h1"}

    made = any_api.client.put(f"{address}/P.1-a_b", json=pose)
    assert made.status_code == 201
    assert made.headers["location"] == f"{address}/P.1-a_b"
    assert made.json() == {"pose_id": "P.1-a_b", "pitch_deg": None, "yaw_deg": None, **pose}

    replaced = any_api.client.put(f"{address}/P.1-a_b", json={"yaw_deg": 5})
    assert replaced.status_code == 200
    assert replaced.json()["position_mm"] is None
    assert any_api.client.get(f"{address}/P.1-a_b").json() == replaced.json()
    assert any_api.client.get(address).json() == {
        "items": [replaced.json()],
        "next_cursor": None,
        "warnings": [],
    }
    assert any_api.client.get(f"{address}/other").json()["code"] == "pose_not_found"


def test_bulk_poses_are_all_or_nothing(any_api: Any) -> None:
    address = f"/v1/sessions/{any_api.make_session()}/poses"
    any_api.client.put(f"{address}/P2", json={"yaw_deg": 5})

    stored = any_api.client.post(address, json=[{"pose_id": f"P{n}", "roll_deg": n} for n in range(200)])
    assert stored.status_code == 200
    assert len(stored.json()["items"]) == 200
    assert any_api.client.get(f"{address}/P2").json()["roll_deg"] == 2
    assert any_api.client.get(f"{address}/P2").json()["yaw_deg"] is None

    twice = any_api.client.post(address, json=[{"pose_id": "new"}, {"pose_id": "P3"}, {"pose_id": "new"}])
    assert (twice.status_code, twice.json()["code"]) == (422, "duplicate_pose")
    assert twice.json()["errors"][0]["field"] == "2.pose_id"
    assert any_api.client.get(f"{address}/new").status_code == 404
    assert any_api.client.post(address, json=[{"pose_id": "ok"}, {"pose_id": "n ok"}]).status_code == 422
    assert any_api.client.get(f"{address}/ok").status_code == 404


def test_deleting_a_session_takes_everything_of_it_but_shared_originals(
    any_api: Any, grey_png: bytes, board_png: bytes
) -> None:
    target_id = any_api.make_target()
    gone, kept = any_api.make_session(target_id), any_api.make_session(target_id)
    shared = any_api.put_image(gone, grey_png).json()
    alone = any_api.put_image(gone, board_png).json()
    survivor = any_api.put_image(kept, grey_png).json()
    blobs = any_api.installation.blobs

    assert any_api.client.delete(f"/v1/sessions/{gone}").status_code == 204

    for address in (f"/v1/sessions/{gone}", f"/v1/measurements/{shared['id']}"):
        assert any_api.client.get(address).status_code == 404
    assert any_api.client.delete(f"/v1/sessions/{gone}").status_code == 404
    assert not blobs.path(alone["sha256"]).exists()
    assert blobs.path(survivor["sha256"]).read_bytes() == grey_png
    assert any_api.client.get(f"/v1/measurements/{survivor['id']}/image").content == grey_png
    assert [job.measurement_id for job in any_api.installation.queue.claim(10)] == [survivor["id"]]


def test_tens_of_thousands_of_poses_go_in_at_once_and_more_are_refused(api: Any) -> None:
    address = f"/v1/sessions/{api.make_session()}/poses"
    assert api.client.put(f"{address}/P7", json={"approach": "from above"}).status_code == 201
    poses = [{"pose_id": f"P{number}", "joint_angles_deg": [number, 0.5]} for number in range(MAX_POSES)]
    answer = api.client.post(address, json=poses)
    assert answer.status_code == 200
    unknown = dict.fromkeys(("position_mm", "roll_deg", "pitch_deg", "yaw_deg", "approach"))
    assert answer.json()["items"][7] == {**poses[7], **unknown}
    for number in (7, MAX_POSES - 1):
        assert api.client.get(f"{address}/P{number}").json() == {**poses[number], **unknown}
    # The pose that was there keeps its place; the others follow in the order they were sent.
    first = api.client.get(address, params={"limit": 3}).json()["items"]
    assert [pose["pose_id"] for pose in first] == ["P7", "P0", "P1"]
    assert api.client.post(address, json=[{"pose_id": "P"}] * (MAX_POSES + 1)).status_code == 422
