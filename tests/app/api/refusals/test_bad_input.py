"""Whatever a client sends, the answer is a 4xx problem in our own words, in the contract's order."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tests.support.service.service import TARGET, assert_problem


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"name": ""}, "name"),
        ({"name": "x" * 201}, "name"),
        ({"name": "a\u0000b"}, "name"),
        ({"name": "a\nb"}, "name"),
        ({"name": "a\u0085b"}, "name"),
        ({"name": "a\u202eb"}, "name"),
        ({"name": " \u00a0 "}, "name"),
        ({"name": "a\u200bb"}, "name"),
        ({"name": "a\u2028b"}, "name"),
        ({"name": "a\U000e0041b"}, "name"),
        ({"name": 5}, "name"),
        ({"name": None}, "name"),
        ({"kind": "chess"}, "kind"),
        ({"kind": "chessboard\n"}, "kind"),
        ({"columns": "9"}, "columns"),
        ({"columns": True}, "columns"),
        ({"columns": 9.5}, "columns"),
        ({"columns": 1}, "columns"),
        ({"columns": 501}, "columns"),
        ({"columns": 10**30}, "columns"),
        ({"rows": None}, "rows"),
        ({"pitch_mm": "25"}, "pitch_mm"),
        ({"pitch_mm": True}, "pitch_mm"),
        ({"pitch_mm": 0}, "pitch_mm"),
        ({"pitch_mm": -1}, "pitch_mm"),
        ({"pitch_mm": 1e300}, "pitch_mm"),
        ({"pitch_mm": 10**400}, "pitch_mm"),
        ({"pitch_mm": [25]}, "pitch_mm"),
        ({"marker_mm": 0}, "marker_mm"),
        ({"dictionary": "DICT\n"}, "dictionary"),
        ({"legacy_layout": 1}, "legacy_layout"),
        ({"legacy_layout": "false"}, "legacy_layout"),
        ({"pitch_standard_uncertainty_mm": -0.1}, "pitch_standard_uncertainty_mm"),
        ({"colour": "red"}, "colour"),
        ({"id": "tgt_mine"}, "id"),
    ],
)
def test_a_wrong_field_is_named(api: Any, change: dict[str, Any], field: str) -> None:
    problem = assert_problem(
        api.client.post("/v1/targets", json={**TARGET, **change}), 422, "invalid_request"
    )
    assert [error["field"] for error in problem["errors"]] == [field]


def test_every_missing_field_is_named(api: Any) -> None:
    problem = assert_problem(api.client.post("/v1/targets", json={}), 422)
    assert {error["field"] for error in problem["errors"]} == {"name", "kind", "columns", "rows", "pitch_mm"}
    assert {error["message"] for error in problem["errors"]} == {"is required"}


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{",
        b"\xff\xfe{}",
        b'{"name": "a"} trailing',
        b"[" * 100_000,
        b'{"a":' * 50_000,
        json.dumps({**TARGET, "pitch_mm": float("nan")}).encode(),
        json.dumps({**TARGET, "pitch_mm": float("inf")}).encode(),
        b'{"name": "board", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": -Infinity}',
        json.dumps({**TARGET, "name": "\ud800"}).encode(),
        json.dumps({**TARGET, "\udfff": 1}).encode(),
        b'{"name": "a", "name": "b"}',
        b'{"pitch_mm": ' + b"9" * 10_000 + b"}",
    ],
)
def test_what_is_no_json_is_refused(api: Any, body: bytes) -> None:
    headers = {"Content-Type": "application/json"}
    assert_problem(api.client.post("/v1/targets", content=body, headers=headers), 422, "invalid_json")


@pytest.mark.parametrize("body", ["null", "5", '"text"', "true", "[]", "[{}]"])
def test_json_of_another_shape_is_refused(api: Any, body: str) -> None:
    headers = {"Content-Type": "application/json"}
    assert_problem(api.client.post("/v1/targets", content=body, headers=headers), 422)


def test_an_overflowing_number_is_refused(api: Any) -> None:
    body = json.dumps({**TARGET, "pitch_mm": 0}).replace('"pitch_mm": 0', '"pitch_mm": 1e999')
    problem = assert_problem(
        api.client.post("/v1/targets", content=body, headers={"Content-Type": "application/json"}), 422
    )
    assert problem["errors"][0]["field"] == "pitch_mm"


@pytest.mark.parametrize("media_type", ["text/plain", "application/x-www-form-urlencoded", "json", ""])
def test_a_body_of_another_media_type_is_refused(api: Any, media_type: str) -> None:
    response = api.client.post(
        "/v1/targets", content=json.dumps(TARGET), headers={"Content-Type": media_type}
    )
    assert_problem(response, 415, "unsupported_media_type")


@pytest.mark.parametrize(
    "joints",
    [
        [],
        [{"a_mm": 1, "alpha_deg": 0, "d_mm": 0}] * 13,
        [{"a_mm": 1, "alpha_deg": 0}],
        [{"a_mm": "1", "alpha_deg": 0, "d_mm": 0}],
        [{"a_mm": 1, "alpha_deg": 0, "d_mm": 0, "gamma_deg": 0}],
        {"0": {"a_mm": 1}},
        None,
    ],
)
def test_wrong_joints_are_refused(api: Any, joints: Any) -> None:
    assert_problem(api.client.post("/v1/robots", json={"name": "r", "joints": joints}), 422)


@pytest.mark.parametrize(
    "change",
    [
        {"name": None},
        {"name": ""},
        {"target_ids": []},
        {"target_ids": None},
        {"target_ids": ["x"] * 17},
        {"target_ids": [5]},
        {"target_ids": "tgt"},
        {"robot_id": 5},
        {"lens": {"focal_length_mm": 8}},
        {"lens": {"focal_length_mm": 0, "pixel_pitch_um": 3}},
        {"lens": 8},
        {"intrinsics": {"fx_px": 1, "fy_px": 1, "cx_px": 0}},
        {"intrinsics": {"fx_px": -1, "fy_px": 1, "cx_px": 0, "cy_px": 0}},
        {"created_at": "2026-01-01T00:00:00Z"},
        {"counts": {}},
    ],
)
def test_wrong_session_fields_are_refused_on_both_ways(api: Any, change: dict[str, Any]) -> None:
    target_id = api.make_target()
    session_id = api.make_session(target_id)
    before = api.client.get(f"/v1/sessions/{session_id}").json()
    assert_problem(
        api.client.post("/v1/sessions", json={"name": "s", "target_ids": [target_id], **change}), 422
    )
    assert_problem(api.client.patch(f"/v1/sessions/{session_id}", json=change), 422)
    assert api.client.get(f"/v1/sessions/{session_id}").json() == before


@pytest.mark.parametrize(
    "pose_id", ["a b", ".hidden", "a%2Fb", "x" * 129, "ä", "a%0A", "%00", "a%00b", "%F0%9F%98%80"]
)
def test_a_wrong_pose_tag_is_refused(api: Any, pose_id: str) -> None:
    session_id = api.make_session()
    response = api.client.put(f"/v1/sessions/{session_id}/poses/{pose_id}", json={})
    # An encoded slash is a slash: that address is nobody's.
    assert_problem(response, 404 if "%2F" in pose_id else 422)
    assert_problem(api.client.post(f"/v1/sessions/{session_id}/poses", json=[{"pose_id": pose_id}]), 422)


@pytest.mark.parametrize(
    "pose",
    [
        {"position_mm": [1, 2]},
        {"position_mm": [1, 2, 3, 4]},
        {"position_mm": [1, 2, None]},
        {"position_mm": [1, 2, 1e10]},
        {"roll_deg": "0"},
        {"joint_angles_deg": []},
        {"joint_angles_deg": [0] * 13},
        {"approach": ""},
        {"approach": "a\tb"},
        {"approach": "a\u202eb"},
        {"pose_id": "P1"},
        {"quaternion": [1, 0, 0, 0]},
    ],
)
def test_a_wrong_pose_is_refused(api: Any, pose: dict[str, Any]) -> None:
    session_id = api.make_session()
    assert_problem(api.client.put(f"/v1/sessions/{session_id}/poses/P1", json=pose), 422)
    assert api.client.get(f"/v1/sessions/{session_id}/poses").json()["items"] == []


@pytest.mark.parametrize("chunked", [False, True])
def test_a_body_over_its_limit_is_refused(api: Any, chunked: bool) -> None:
    headers = {"Content-Type": "application/json"}

    def send(address: str, body: bytes) -> Any:
        content = (body[i : i + 65536] for i in range(0, len(body), 65536)) if chunked else body
        return api.client.post(address, content=content, headers=headers)

    padded = json.dumps(TARGET).encode()
    assert send("/v1/targets", padded + b" " * (1024 * 1024 - len(padded))).status_code == 201
    assert_problem(
        send("/v1/targets", padded + b" " * (1024 * 1024 + 1 - len(padded))), 413, "body_too_large"
    )
    bulk = f"/v1/sessions/{api.make_session()}/poses"
    assert send(bulk, b"[]" + b" " * (16 * 1024 * 1024 - 2)).status_code == 200
    assert_problem(send(bulk, b"[]" + b" " * (16 * 1024 * 1024)), 413, "body_too_large")


def test_a_lying_content_length_is_no_defect(api: Any) -> None:
    headers = {"Content-Type": "application/json", "Content-Length": "abc"}
    assert_problem(api.client.post("/v1/targets", content=b"{}", headers=headers), 422)


def test_a_bound_is_stated_exactly(api: Any) -> None:
    session_id = api.make_session()
    problem = assert_problem(
        api.client.put(
            f"/v1/sessions/{session_id}/poses/P1/images/{'0' * 64}", params={"cycle": 2**31}, content=b"x"
        ),
        422,
    )
    assert problem["errors"] == [{"field": "cycle", "message": "must be at most 2147483647"}]
