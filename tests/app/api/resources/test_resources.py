"""Targets, robots, sessions and poses: made, read, changed, listed, deleted; on both databases."""

from __future__ import annotations

from typing import Any

import pytest

from app.api.schemas.poses import MAX_POSES

ROBOT: dict[str, Any] = {
    "name": "KR5",
    "joints": [{"a_mm": 180, "alpha_deg": -90, "d_mm": 400, "theta_offset_deg": 0}],
    "datasheet_repeatability_mm": 0.04,
}


def test_a_target_is_read_as_it_was_made(any_api: Any) -> None:
    made = any_api.client.post(
        "/v1/targets",
        json={"name": "A3 board ø", "kind": "chessboard", "columns": 14, "rows": 10, "pitch_mm": 21.5},
    )
    assert made.status_code == 201
    document = made.json()
    assert {key: document[key] for key in ("name", "kind", "columns", "rows", "pitch_mm")} == {
        "name": "A3 board ø",
        "kind": "chessboard",
        "columns": 14,
        "rows": 10,
        "pitch_mm": 21.5,
    }
    assert document["legacy_layout"] is False
    assert (
        document["marker_mm"] is document["dictionary"] is document["pitch_standard_uncertainty_mm"] is None
    )
    assert document["created_at"].endswith("Z")
    assert made.headers["location"] == f"/v1/targets/{document['id']}"
    assert any_api.client.get(made.headers["location"]).json() == document


CHARUCO = {
    "name": "x",
    "kind": "charuco",
    "columns": 7,
    "rows": 5,
    "pitch_mm": 30.0,
    "marker_mm": 21.0,
    "dictionary": "DICT_APRILTAG_36h11",
}


def test_a_charuco_board_is_read_as_it_was_made(api: Any) -> None:
    made = api.client.post("/v1/targets", json={**CHARUCO, "legacy_layout": True})
    assert made.status_code == 201, made.text
    document = api.client.get(made.headers["location"]).json()
    assert {name: document[name] for name in CHARUCO} == CHARUCO
    assert document["legacy_layout"] is True


@pytest.mark.parametrize(
    ("changes", "words", "field"),
    [
        ({"dictionary": "DICT_9X9_50"}, "Unknown marker dictionary", "dictionary"),
        ({"dictionary": "6x6_250"}, "Unknown marker dictionary '6x6_250'", "dictionary"),
        ({"dictionary": "DetectorParameters"}, "Unknown marker dictionary", "dictionary"),
        ({"dictionary": None}, "dictionary is required for ChArUco boards", "dictionary"),
        ({"dictionary": "DICT_4X4_50", "columns": 14, "rows": 10}, "82 markers", "dictionary"),
        ({"marker_mm": None}, "marker_mm is required for ChArUco boards", "marker_mm"),
        ({"marker_mm": 1e-5}, "marker_mm", "marker_mm"),
        ({"marker_mm": 30.0}, "marker_mm", "marker_mm"),
        ({"columns": 2}, "2 x 5", "columns"),
        ({"rows": 2}, "7 x 2", "rows"),
    ],
)
def test_a_charuco_board_that_cannot_be_is_refused_with_advice(
    api: Any, changes: dict[str, Any], words: str, field: str
) -> None:
    response = api.client.post("/v1/targets", json={**CHARUCO, **changes})
    assert (response.status_code, response.json()["code"]) == (422, "invalid_target")
    assert words in response.json()["detail"]
    assert response.json()["advice"]
    assert [error["field"] for error in response.json()["errors"]] == [field]
    assert api.client.get("/v1/targets").json()["items"] == []


@pytest.mark.parametrize("pitch_mm", [0.0, -1.0, 1e-320, 9e-7, 1e10])
def test_a_pitch_that_no_print_has_is_refused(api: Any, pitch_mm: float) -> None:
    response = api.client.post("/v1/targets", json={**CHARUCO, "pitch_mm": pitch_mm})
    assert response.status_code == 422
    assert "pitch_mm" in [error["field"] for error in response.json()["errors"]]


def test_a_pitch_with_total_uncertainty_is_refused(api: Any) -> None:
    wanted = {"name": "x", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": 25.0}
    for uncertainty, status in ((25.0, 422), (24.9, 201)):
        response = api.client.post(
            "/v1/targets?accept_implausible=true",
            json={**wanted, "pitch_standard_uncertainty_mm": uncertainty},
        )
        assert response.status_code == status, response.text
        if status == 422:
            assert response.json()["code"] == "invalid_target"
            assert "pitch_standard_uncertainty_mm" in response.json()["detail"]
            (error,) = response.json()["errors"]
            assert error["field"] == "pitch_standard_uncertainty_mm"


@pytest.mark.parametrize("kind", ["chessboard", "circles", "asymmetric_circles"])
@pytest.mark.parametrize("field", ["columns", "rows"])
def test_a_grid_that_no_image_can_be_searched_for_is_refused(api: Any, kind: str, field: str) -> None:
    wanted = {"name": "x", "kind": kind, "columns": 5, "rows": 4, "pitch_mm": 25.0}
    response = api.client.post("/v1/targets", json=wanted | {field: 2})
    assert (response.status_code, response.json()["code"]) == (422, "invalid_target")
    assert [error["field"] for error in response.json()["errors"]] == [field]
    assert api.client.post("/v1/targets", json=wanted | {field: 3}).status_code == 201


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        ("chessboard", "marker_mm", 10.0),
        ("chessboard", "dictionary", "DICT_4X4_50"),
        ("chessboard", "legacy_layout", True),
        ("circles", "dictionary", "DICT_4X4_50"),
        ("asymmetric_circles", "legacy_layout", True),
        ("aprilgrid", "legacy_layout", True),
    ],
)
def test_what_a_kind_of_target_has_not_is_refused_by_name(
    api: Any, kind: str, field: str, value: object
) -> None:
    wanted = {"name": "x", "kind": kind, "columns": 5, "rows": 4, "pitch_mm": 25.0}
    if kind == "aprilgrid":
        wanted |= {"marker_mm": 20.0, "dictionary": "DICT_APRILTAG_36h11"}
    response = api.client.post("/v1/targets", json=wanted | {field: value})
    assert (response.status_code, response.json()["code"]) == (422, "invalid_target")
    assert [error["field"] for error in response.json()["errors"]] == [field]
    nothing: dict[str, Any] = {"pitch_standard_uncertainty_mm": None, "legacy_layout": False}
    if kind != "aprilgrid":
        nothing |= {"marker_mm": None, "dictionary": None}
    assert api.client.post("/v1/targets", json=wanted | nothing).status_code == 201


def test_the_diameter_of_dots_is_kept(api: Any) -> None:
    wanted = {"name": "x", "kind": "circles", "columns": 5, "rows": 4, "pitch_mm": 25.0, "marker_mm": 12.0}
    made = api.client.post("/v1/targets", json=wanted)
    assert (made.status_code, made.json()["marker_mm"]) == (201, 12.0)


@pytest.mark.parametrize(
    ("changes", "word", "field"),
    [
        ({}, "marker_mm is required for AprilGrids", "marker_mm"),
        ({"marker_mm": 30}, "less than its pitch_mm of 30, got 30", "marker_mm"),
        ({"marker_mm": 45}, "less than its pitch_mm of 30, got 45", "marker_mm"),
        ({"marker_mm": 29.5}, "gaps", "marker_mm"),
        ({"marker_mm": 2}, "gaps", "marker_mm"),
        ({"marker_mm": 24, "dictionary": "DICT_6X6_250"}, "36h11", "dictionary"),
        ({"marker_mm": 24, "dictionary": "tag36h11"}, "Unknown marker dictionary", "dictionary"),
        ({"marker_mm": 24, "dictionary": "DICT_9X9_50"}, "Unknown marker dictionary", "dictionary"),
        ({"marker_mm": 24, "columns": 30, "rows": 20}, "600 tags", "columns"),
        ({"marker_mm": 24, "columns": 20, "rows": 30}, "600 tags", "rows"),
    ],
)
def test_an_aprilgrid_that_cannot_be_printed_is_refused(
    api: Any, changes: dict[str, Any], word: str, field: str
) -> None:
    wanted = {"name": "x", "kind": "aprilgrid", "columns": 5, "rows": 7, "pitch_mm": 30}
    response = api.client.post("/v1/targets", json=wanted | changes)
    assert response.status_code == 422
    assert response.json()["code"] == "invalid_target"
    assert word in response.json()["detail"]
    assert response.json()["advice"]
    assert [error["field"] for error in response.json()["errors"]] == [field]
    assert api.client.get("/v1/targets").json()["items"] == []
    assert api.client.post("/v1/targets", json=wanted | {"marker_mm": 24}).status_code == 201


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


def test_lists_run_from_oldest_to_newest_by_pages(any_api: Any) -> None:
    made = [any_api.make_target(name=f"t{n}") for n in range(7)]
    seen, cursor, sizes = [], None, []
    while True:
        query = {"limit": 3} if cursor is None else {"limit": 3, "cursor": cursor}
        page = any_api.client.get("/v1/targets", params=query).json()
        seen += [item["id"] for item in page["items"]]
        sizes.append(len(page["items"]))
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert seen == made
    assert sizes == [3, 3, 1]
    assert any_api.client.get("/v1/targets", params={"limit": 7}).json()["next_cursor"] is None


def test_a_cursor_is_of_one_list_with_its_filters(any_api: Any) -> None:
    targets = [any_api.make_target(name="t") for _ in range(3)]
    sessions = [any_api.make_session(targets[0]) for _ in range(2)]
    for session in sessions:
        poses = [{"pose_id": f"P{n}"} for n in range(3)]
        assert any_api.client.post(f"/v1/sessions/{session}/poses", json=poses).status_code == 200

    def page(path: str, **query: object) -> Any:
        return any_api.client.get(path, params={"limit": 1, **query})

    of_targets = page("/v1/targets").json()["next_cursor"]
    of_poses = page(f"/v1/sessions/{sessions[0]}/poses").json()["next_cursor"]
    others = [
        (f"/v1/sessions/{sessions[1]}/poses", {"cursor": of_poses}),
        ("/v1/targets", {"cursor": of_poses}),
        ("/v1/sessions", {"cursor": of_targets}),
        ("/v1/targets", {"cursor": of_targets, "name": "t"}),
    ]
    for path, query in others:
        response = page(path, **query)
        assert (response.status_code, response.json()["code"]) == (422, "invalid_cursor")
    assert page("/v1/targets", cursor=of_targets).json()["items"][0]["id"] == targets[1]
    # The row that a cursor names may be gone.
    assert any_api.client.delete(f"/v1/targets/{targets[1]}").status_code == 204
    following = page("/v1/targets", cursor=page("/v1/targets").json()["next_cursor"])
    assert following.json()["items"][0]["id"] == targets[2]


def test_lists_are_asked_for_a_name(any_api: Any) -> None:
    joints = [{"a_mm": 100.0, "alpha_deg": 90.0, "d_mm": 0.0}]
    for name in ("Zelle 7", "Zelle 7", "zelle 7", "Zelle"):
        target = any_api.make_target(name=name)
        any_api.make_session(target, name=name)
        assert any_api.client.post("/v1/robots", json={"name": name, "joints": joints}).status_code == 201
    for path in ("/v1/targets", "/v1/sessions", "/v1/robots"):
        found = any_api.client.get(path, params={"name": "Zelle 7", "limit": 1}).json()
        following = {"name": "Zelle 7", "cursor": found["next_cursor"]}
        items = found["items"] + any_api.client.get(path, params=following).json()["items"]
        assert [item["name"] for item in items] == ["Zelle 7"] * 2
        assert items[0]["id"] != items[1]["id"]
        assert any_api.client.get(path, params={"name": "%"}).json()["items"] == []
        assert any_api.client.get(path, params={"name": "x" * 201}).status_code == 422


def test_a_list_gives_fifty_items_unless_asked_otherwise(api: Any) -> None:
    address = f"/v1/sessions/{api.make_session()}/poses"
    api.client.post(address, json=[{"pose_id": f"P{n:03}"} for n in range(60)])
    assert len(api.client.get(address).json()["items"]) == 50
    assert len(api.client.get(address, params={"limit": 500}).json()["items"]) == 60


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
