"""Sessions, targets, robots and keys that cannot be read: what refers to them fails alone, and says so."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import pytest

from app.services.keys import create_key, list_keys, revoke_key
from tests.support.records.damaged_rows import CODE, KUKA, damage, get, upload


@pytest.mark.parametrize(
    ("statement", "column"),
    [
        pytest.param(
            'UPDATE sessions SET lens = \'{"focal_length_mm": "long"}\' WHERE id = :session_id',
            "session.lens",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "UPDATE sessions SET intrinsics = '[1]' WHERE id = :session_id",
            "session.intrinsics",
            marks=pytest.mark.slow,
        ),
        ("UPDATE targets SET kind = 'mosaic' WHERE id = :target_id", "target "),
        pytest.param(
            "UPDATE targets SET pitch_mm = 0 WHERE id = :target_id", "target ", marks=pytest.mark.slow
        ),
    ],
)
def test_a_damaged_session_or_target_fails_its_own_images_alone(
    any_api: Any, grey_png: bytes, statement: str, column: str
) -> None:
    session_id, (bad,) = upload(any_api, grey_png, "a")
    other_id, (good,) = upload(any_api, grey_png, "b")
    target_id = get(any_api, f"/v1/sessions/{session_id}")["target_ids"][0]
    values = {"session_id": session_id} if ":session_id" in statement else {"target_id": target_id}
    damage(any_api, statement, **values)
    assert [job.measurement_id for job in any_api.installation.queue.claim(8)] == [good]
    failure = get(any_api, f"/v1/measurements/{bad}")["failure"]
    assert failure["code"] == CODE
    assert column in failure["detail"]
    for path in ("measurements", "poses", "measured-poses"):
        assert len(get(any_api, f"/v1/sessions/{session_id}/{path}")["items"]) <= 1
    page = get(any_api, "/v1/sessions")
    listed = [item["id"] for item in page["items"]]
    if "session" in column:
        assert listed == [other_id]
        assert [warning["code"] for warning in page["warnings"]] == [CODE]
        assert session_id in page["warnings"][0]["detail"]
        assert get(any_api, f"/v1/sessions/{session_id}", 409)["code"] == CODE
        assert get(any_api, f"/v1/sessions/{session_id}/repeatability", 409)["code"] == CODE
        # The damage is undone by what anybody would try first.
        changed = {column.removeprefix("session."): None}
        assert any_api.client.patch(f"/v1/sessions/{session_id}", json=changed).status_code == 200
        assert any_api.client.post(f"/v1/measurements/{bad}/retry").status_code == 202
        assert [job.measurement_id for job in any_api.installation.queue.claim(8)] == [bad]
    else:
        assert listed == [session_id, other_id]
        assert any_api.client.get("/v1/targets").status_code == 200
        assert get(any_api, f"/v1/sessions/{session_id}/repeatability", 409)["code"] == CODE
    assert any_api.client.delete(f"/v1/sessions/{session_id}").status_code == 204


@pytest.mark.slow
def test_lists_exclude_what_cannot_be_read_and_say_so(any_api: Any) -> None:
    robot = any_api.client.post("/v1/robots", json={"name": "arm", "joints": KUKA}).json()["id"]
    other = any_api.client.post("/v1/robots", json={"name": "other", "joints": KUKA}).json()["id"]
    session_id = any_api.make_session(robot_id=robot)
    for pose_id in ("P1", "P2"):
        any_api.client.put(
            f"/v1/sessions/{session_id}/poses/{pose_id}", json={"position_mm": [1.0, 2.0, 3.0]}
        )
    readings = [{"pose_id": "P1", "cycle": cycle, "position_mm": [1.0, 2.0, 3.0]} for cycle in (1, 2)]
    assert any_api.client.post(f"/v1/sessions/{session_id}/measured-poses", json=readings).status_code == 200
    damage(any_api, "UPDATE robots SET joints = '[{\"a_mm\": null}]' WHERE id = :id", id=robot)
    damage(any_api, "UPDATE poses SET position_mm = '[1, \"x\"]' WHERE pose_id = 'P1'")
    damage(any_api, "UPDATE measured_poses SET position_mm = '7' WHERE cycle = 1")
    for path, left in (
        ("/v1/robots", [other]),
        (f"/v1/sessions/{session_id}/poses", ["P2"]),
        (f"/v1/sessions/{session_id}/measured-poses", [2]),
    ):
        page = get(any_api, path)
        assert [item.get("cycle") or item.get("pose_id") or item["id"] for item in page["items"]] == left
        assert [warning["code"] for warning in page["warnings"]] == [CODE]
    assert get(any_api, f"/v1/robots/{robot}", 409)["code"] == CODE
    assert get(any_api, f"/v1/sessions/{session_id}/poses/P1", 409)["code"] == CODE
    analysis = get(any_api, f"/v1/sessions/{session_id}/repeatability?source=measured_poses", 409)
    assert analysis["code"] == CODE
    plan = {"target_id": any_api.make_target(), "poses": [{"joint_angles_deg": [0.0] * 6}]}
    assert any_api.client.post(f"/v1/robots/{robot}/dh-plan", json=plan).status_code < 500
    # A pose is what the user says it is: saying it again mends it.
    assert any_api.client.put(f"/v1/sessions/{session_id}/poses/P1", json={}).status_code == 200
    assert get(any_api, f"/v1/sessions/{session_id}/poses/P1")["position_mm"] is None


def test_a_key_that_cannot_be_read_lets_nobody_in(any_api: Any) -> None:
    installation = any_api.installation
    key = create_key(installation, "door", "admin", expires_in=timedelta(days=1))
    headers = {"Authorization": f"Bearer {key.secret_key}"}
    assert any_api.client.get("/v1/sessions", headers=headers).status_code == 200
    value = "'soon'" if installation.database.is_sqlite else "'infinity'"
    damage(any_api, f"UPDATE api_keys SET expires_at = {value} WHERE id = :id", id=key.key.id)
    assert any_api.client.get("/v1/sessions", headers=headers).status_code == 401
    page = get(any_api, "/v1/keys")
    assert [warning["code"] for warning in page["warnings"]] == [CODE]
    assert key.key.id in page["warnings"][0]["detail"]
    revoke_key(installation, key.key.id)
    assert any(row.revoked_at for row in list_keys(installation)[0] if row.id == key.key.id)


UNREADABLE_TARGETS = [
    ("certificate", "[1]"),
    ("certificate", '{"points_mm": [[1]]}'),
    ("certificate", '{"pitch_x_mm": "a"}'),
    ("certificate", "{}"),
    ("shape_standard_uncertainty", '{"kind": 1}'),
    ("print_kind", "cloth"),
]


@pytest.mark.slow
def test_what_was_measured_of_a_target_and_cannot_be_read_stops_nothing(any_api: Any) -> None:
    for column, text in UNREADABLE_TARGETS:
        target_id = any_api.make_target()
        session_id = any_api.make_session(target_id)
        damage(any_api, f"UPDATE targets SET {column} = :text WHERE id = :id", text=text, id=target_id)
        get(any_api, "/v1/targets")
        assert any_api.client.get(f"/v1/targets/{target_id}").status_code < 500, (column, text)
        assert get(any_api, f"/v1/sessions/{session_id}/repeatability", 409)["code"] == CODE, (column, text)


@pytest.mark.slow
def test_a_coupling_that_cannot_be_read_stops_nothing(any_api: Any) -> None:
    for coupling in ("[1]", "[[1]]", '[["a"]]', "{}", "[[1, 2], [3]]"):
        robot = any_api.client.post("/v1/robots", json={"name": "arm", "joints": KUKA}).json()["id"]
        session_id = any_api.make_session(robot_id=robot)
        damage(any_api, "UPDATE robots SET joint_coupling = :value WHERE id = :id", value=coupling, id=robot)
        assert any_api.client.get(f"/v1/robots/{robot}").status_code < 500, coupling
        assert get(any_api, f"/v1/sessions/{session_id}/dh", 409)["code"] == CODE, coupling
