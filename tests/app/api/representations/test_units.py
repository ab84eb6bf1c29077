"""Values that are almost surely in another unit are refused with the guess, unless the client insists."""

from __future__ import annotations

import math
from typing import Any

import pytest

from tests.support.service.service import TARGET

JOINT = {"a_mm": 180.0, "alpha_deg": -90.0, "d_mm": 400.0}
INSIST = {"accept_implausible": "true"}


@pytest.mark.parametrize(
    ("joints", "field", "guess"),
    [
        ([{**JOINT, "alpha_deg": math.pi / 2}, {**JOINT, "alpha_deg": 0.0}], "joints.0.alpha_deg", "radians"),
        ([{**JOINT, "minimum_deg": -2.96, "maximum_deg": 2.96}], "joints.0.minimum_deg", "radians"),
        (
            [{**JOINT, "a_mm": 0.18, "d_mm": 0.4}, {**JOINT, "a_mm": -0.6, "d_mm": 0.0}],
            "joints.0.a_mm",
            "metres",
        ),
        ([{**JOINT, "a_mm": 0.18}, {**JOINT, "a_mm": -0.6, "alpha_deg": 0.0}], "joints.1.a_mm", "metres"),
        (
            [{**JOINT, "a_mm": 0.0, "d_mm": 0.34}, {**JOINT, "a_mm": 0.0, "d_mm": 0.4}],
            "joints.1.d_mm",
            "metres",
        ),
    ],
)
def test_a_robot_in_radians_or_metres_is_refused(
    api: Any, joints: list[dict[str, float]], field: str, guess: str
) -> None:
    body = {"name": "R", "joints": joints}
    refused = api.client.post("/v1/robots", json=body)
    assert (refused.status_code, refused.json()["code"]) == (422, "implausible_unit")
    assert field in [error["field"] for error in refused.json()["errors"]]
    assert guess in refused.json()["detail"]
    assert "accept_implausible" in refused.json()["advice"]
    assert api.client.post("/v1/robots", json=body, params=INSIST).status_code == 201


@pytest.mark.parametrize(
    "joints",
    [
        [{**JOINT, "alpha_deg": 0.0}, {**JOINT, "alpha_deg": 0.02}],  # a SCARA as calibrated
        [{**JOINT, "a_mm": 0.0}],  # an arm whose axes all meet
        [{**JOINT, "a_mm": 0.9}, {**JOINT, "a_mm": -1.3, "d_mm": 0.4}],  # such an arm as identified
        [{**JOINT, "minimum_deg": -170.0, "maximum_deg": 5.0}],
        [{**JOINT, "a_mm": 3.0}, JOINT],
    ],
)
def test_what_may_be_is_stored(api: Any, joints: list[dict[str, float]]) -> None:
    assert api.client.post("/v1/robots", json={"name": "R", "joints": joints}).status_code == 201


def test_a_pitch_in_metres_is_refused(api: Any) -> None:
    body = {**TARGET, "pitch_mm": 0.025}
    refused = api.client.post("/v1/targets", json=body)
    assert (refused.status_code, refused.json()["code"]) == (422, "implausible_unit")
    assert [error["field"] for error in refused.json()["errors"]] == ["pitch_mm"]
    assert "25 mm" in refused.json()["detail"]
    assert api.client.post("/v1/targets", json=body, params=INSIST).status_code == 201
    assert api.client.post("/v1/targets", json={**body, "pitch_mm": 0.2}).status_code == 201


@pytest.mark.parametrize(
    ("poses", "field", "guess"),
    [
        ([{"position_mm": [0.4, 0.1, 0.5]}, {"position_mm": [0.5, -0.1, 0.5]}], "0.position_mm", "400 mm"),
        (
            [{"joint_angles_deg": [0.0, -1.5708]}, {"joint_angles_deg": [0.2, -1.2]}],
            "1.joint_angles_deg",
            "-90°",
        ),
        (
            [{"roll_deg": 3.14159}, {"roll_deg": 3.14159, "pitch_deg": 0.0, "yaw_deg": 0.3}],
            "0.roll_deg",
            "180°",
        ),
        ([{"joint_angles_deg": [0.0, -1.57, 1.571, 0.0]}], "0.joint_angles_deg", "-89.95°"),
    ],
)
def test_commanded_poses_in_metres_or_radians_are_refused(
    api: Any, poses: list[dict[str, Any]], field: str, guess: str
) -> None:
    path = f"/v1/sessions/{api.make_session()}/poses"
    body = [{"pose_id": f"P{place}", **pose} for place, pose in enumerate(poses, start=1)]
    refused = api.client.post(path, json=body)
    assert (refused.status_code, refused.json()["code"]) == (422, "implausible_unit")
    assert field in [error["field"] for error in refused.json()["errors"]]
    assert guess in refused.json()["detail"]
    assert api.client.get(path).json()["items"] == []
    assert api.client.post(path, json=body, params=INSIST).status_code == 200


def test_one_commanded_pose_in_radians_is_refused(api: Any) -> None:
    path = f"/v1/sessions/{api.make_session()}/poses/P1"
    refused = api.client.put(path, json={"joint_angles_deg": [0.1, -1.5708, 1.2]})
    assert (refused.status_code, refused.json()["code"]) == (422, "implausible_unit")
    assert [error["field"] for error in refused.json()["errors"]] == ["joint_angles_deg"] * 3
    assert api.client.put(path, json={"joint_angles_deg": [0.1, -1.5708]}, params=INSIST).status_code == 201


@pytest.mark.parametrize(
    "poses",
    [
        [{"position_mm": [0.0, 0.0, 0.0]}, {"position_mm": [0.0, 0.0, 0.0]}],
        [{"position_mm": [1.0, 2.0, 3.0]}],
        [
            {"position_mm": [1.0, 2.0, 3.0], "yaw_deg": 2.0},
            {"position_mm": [400.0, 2.0, 3.0], "yaw_deg": 2.5},
        ],
        [{"joint_angles_deg": [0.0, 1.5]}, {"joint_angles_deg": [30.0, -1.0]}],
        [{"joint_angles_deg": [0.0, 5.0, 0.0]}],
        [{"roll_deg": 0.2, "pitch_deg": 1.5}, {"roll_deg": -0.1}],
        [{}, {}],
    ],
)
def test_plausible_poses_are_stored(api: Any, poses: list[dict[str, Any]]) -> None:
    path = f"/v1/sessions/{api.make_session()}/poses"
    body = [{"pose_id": f"P{place}", **pose} for place, pose in enumerate(poses, start=1)]
    assert api.client.post(path, json=body).status_code == 200


INTRINSICS = {"fx_px": 1600.0, "fy_px": 1600.0, "cx_px": 960.0, "cy_px": 600.0}
CAMERAS: list[tuple[dict[str, Any], str, str]] = [
    ({"lens": {"focal_length_mm": 0.016, "pixel_pitch_um": 5.5}}, "lens.focal_length_mm", "16 mm"),
    ({"lens": {"focal_length_mm": 16.0, "pixel_pitch_um": 0.0055}}, "lens.pixel_pitch_um", "5.5 µm"),
    ({"lens": {"focal_length_mm": 16.0, "pixel_pitch_um": 5.5e-6}}, "lens.pixel_pitch_um", "5.5 µm"),
    ({"intrinsics": dict.fromkeys(INTRINSICS, 0.5)}, "intrinsics.fx_px", "320 px"),
    ({"intrinsics": {**INTRINSICS, "fx_px": 16.0, "fy_px": 16.0}}, "intrinsics.fx_px", "millimetres"),
    ({"intrinsics": {**INTRINSICS, "fx_px": 0.016, "fy_px": 0.016}}, "intrinsics.fx_px", "3200 px"),
]


@pytest.mark.parametrize(("camera", "field", "guess"), CAMERAS)
def test_a_camera_in_other_units_is_refused(api: Any, camera: dict[str, Any], field: str, guess: str) -> None:
    session = api.client.get(f"/v1/sessions/{api.make_session()}").json()
    body = {"name": "S", "target_ids": session["target_ids"], **camera}
    for method, path, content in (
        ("POST", "/v1/sessions", body),
        ("PATCH", f"/v1/sessions/{session['id']}", camera),
    ):
        refused = api.client.request(method, path, json=content)
        assert (refused.status_code, refused.json()["code"]) == (422, "implausible_unit")
        assert field in [error["field"] for error in refused.json()["errors"]]
        assert guess in refused.json()["detail"]
        assert api.client.request(method, path, json=content, params=INSIST).status_code in (200, 201)


@pytest.mark.parametrize(
    "camera",
    [
        {"lens": {"focal_length_mm": 1.6, "pixel_pitch_um": 0.8}},
        {"lens": {"focal_length_mm": 600.0, "pixel_pitch_um": 50.0}},
        {"intrinsics": INTRINSICS},
        {"intrinsics": {"fx_px": 210.0, "fy_px": 210.0, "cx_px": 960.0, "cy_px": 600.0}},
        {"intrinsics": None, "lens": None},
    ],
)
def test_plausible_cameras_are_stored(api: Any, camera: dict[str, Any]) -> None:
    assert api.client.patch(f"/v1/sessions/{api.make_session()}", json=camera).status_code == 200


@pytest.mark.parametrize("field", ["datasheet_repeatability_mm", "datasheet_accuracy_mm"])
def test_a_data_sheet_in_metres_is_refused(api: Any, field: str) -> None:
    body = {"name": "R", "joints": [JOINT], field: 0.00002}
    refused = api.client.post("/v1/robots", json=body)
    assert (refused.status_code, refused.json()["code"]) == (422, "implausible_unit")
    assert "0.02 mm" in refused.json()["detail"]
    made = api.client.post("/v1/robots", json=body, params=INSIST)
    assert made.status_code == 201
    path = f"/v1/robots/{made.json()['id']}"
    assert api.client.patch(path, json={field: 0.00002}).json()["code"] == "implausible_unit"
    assert api.client.patch(path, json={field: 0.005}).status_code == 200


@pytest.mark.parametrize(
    ("factor", "unit"),
    [(0.001, "metres"), (0.1, "centimetres"), (1 / 25.4, "inches"), (1000.0, "micrometres")],
)
def test_a_certificate_in_another_unit_is_refused_with_the_guess(api: Any, factor: float, unit: str) -> None:
    pitch = TARGET["pitch_mm"]
    stated = {
        "pitch_x_mm": 1.0004 * pitch * factor,
        "pitch_y_mm": pitch * factor,
        "standard_uncertainty": {"pitch_x_mm": 0.001, "pitch_y_mm": 0.001, "squareness_mrad": 0.1},
    }
    points = {
        "points_mm": [
            [pitch * factor * c, pitch * factor * r, 0.0]
            for r in range(TARGET["rows"])
            for c in range(TARGET["columns"])
        ],
        "points_standard_uncertainty_mm": 0.001,
    }
    target = api.client.post("/v1/targets", json=TARGET).json()["id"]
    for certificate, field in ((stated, "certificate.pitch_x_mm"), (points, "certificate.points_mm")):
        for refused in (
            api.client.post("/v1/targets", json={**TARGET, "certificate": certificate}),
            api.client.patch(f"/v1/targets/{target}", json={"certificate": certificate}),
        ):
            assert (refused.status_code, refused.json()["code"]) == (422, "certificate_unit_mismatch")
            assert refused.json()["errors"][0]["field"] == field
            assert unit in refused.json()["detail"]


@pytest.mark.parametrize(
    "field", ["pitch_standard_uncertainty_mm", "standard_uncertainty", "points_standard_uncertainty_mm"]
)
def test_an_uncertainty_as_large_as_its_pitch_is_refused_unless_it_is_meant(api: Any, field: str) -> None:
    certificate: dict[str, Any] = {"pitch_x_mm": TARGET["pitch_mm"], "pitch_y_mm": TARGET["pitch_mm"]}
    certificate["standard_uncertainty"] = {"pitch_x_mm": 0.003, "pitch_y_mm": TARGET["pitch_mm"]}
    if field == "points_standard_uncertainty_mm":
        rows, columns, pitch = (TARGET[name] for name in ("rows", "columns", "pitch_mm"))
        points = [[pitch * c, pitch * r, 0.0] for r in range(rows) for c in range(columns)]
        certificate = {"points_mm": points, field: 3.0}
    stated = {field: 3.0} if field.startswith("pitch") else {"certificate": certificate}
    refused = api.client.post("/v1/targets", json={**TARGET, **stated})
    assert (refused.status_code, refused.json()["code"]) == (422, "implausible_unit")
    assert "micrometres" in refused.json()["detail"]
    (error,) = refused.json()["errors"]
    assert field in error["field"]
    accepted = api.client.post("/v1/targets?accept_implausible=true", json={**TARGET, **stated})
    assert accepted.status_code == 201
    if "certificate" in stated:
        address = f"/v1/targets/{accepted.json()['id']}"
        assert api.client.patch(address, json={"name": "The sheet of cell 4"}).status_code == 200
        refused = api.client.patch(address, json=stated)
        assert (refused.status_code, refused.json()["code"]) == (422, "implausible_unit")
        assert api.client.patch(f"{address}?accept_implausible=true", json=stated).status_code == 200
