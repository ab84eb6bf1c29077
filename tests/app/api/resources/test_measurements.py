"""From a photograph to its calibration and back out, through a real worker process."""

from __future__ import annotations

import hashlib
import json
import math
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from core.simulation.renderer import render
from core.targets.specification import TargetSpec
from tests.support.service.events import read_events
from tests.support.simulation.scenes import standard_scene

SQUARE = {"position_mm": (3,), "rotation": (3, 3), "covariance": (6, 6), "covariance_given_camera": (6, 6)}


@pytest.fixture(scope="module")
def measured(computing_api: Any, board_png: bytes) -> dict[str, Any]:
    """A rendered board, measured."""
    session_id = computing_api.make_session()
    accepted = computing_api.put_image(session_id, board_png, cycle=1)
    assert accepted.status_code == 202, accepted.text
    document: dict[str, Any] = computing_api.wait_for(accepted.json()["id"])
    return document


def test_a_rendered_board_gives_its_camera_and_pose(measured: dict[str, Any]) -> None:
    target = TargetSpec("chessboard", 9, 6, 25.0)
    truth = standard_scene(target, seed=1, tilt=math.radians(30.0), clutter=0.0)
    assert (measured["status"], measured["failure"], measured["attempts"]) == ("succeeded", None, 1)
    assert measured["duration_ms"] > 0
    assert measured["finished_at"] >= measured["received_at"]
    calibration = measured["calibration"]
    assert calibration["estimator"] == "per_image"
    assert (calibration["image_width_px"], calibration["image_height_px"]) == (2448, 2050)
    fx, u_fx = calibration["intrinsics"]["fx_px"], calibration["standard_uncertainty"]["fx_px"]
    # Five standard uncertainties: one image of one seed, which must not fail by mere chance.
    assert abs(fx - truth.camera.fx_px) < 5 * u_fx
    T_target_camera = np.linalg.inv(truth.T_camera_target)
    u_position = [calibration["pose"]["standard_uncertainty"][name] for name in ("x_mm", "y_mm", "z_mm")]
    error = np.abs(np.array(calibration["pose"]["position_mm"]) - T_target_camera[:3, 3])
    assert np.all(error < 5 * np.array(u_position))
    # The grid's ends cannot look the same at 9 x 6, so the rotation is the true one, not one turned by 180°.
    assert np.trace(np.array(calibration["pose"]["rotation"]).T @ T_target_camera[:3, :3]) > 2.99


def test_the_document_is_consistent_in_itself(measured: dict[str, Any]) -> None:
    calibration = measured["calibration"]
    pose = calibration["pose"]
    for name, shape in SQUARE.items():
        assert np.array(pose[name]).shape == shape
    T_camera_target = np.array(calibration["T_camera_target"])
    assert np.allclose(np.array(pose["rotation"]), T_camera_target[:3, :3].T, atol=1e-12)
    assert np.allclose(pose["position_mm"], -T_camera_target[:3, :3].T @ T_camera_target[:3, 3], atol=1e-3)
    u = pose["standard_uncertainty"]
    assert np.allclose([u["x_mm"], u["y_mm"], u["z_mm"]], np.sqrt(np.diag(pose["covariance"])[:3]), rtol=1e-3)
    roll, pitch, yaw = (math.radians(pose[f"{axis}_deg"]) for axis in ("roll", "pitch", "yaw"))
    x, y, z = (np.array(v, float) for v in ([1, 0, 0], [0, 1, 0], [0, 0, 1]))
    rotation = cv2.Rodrigues(z * yaw)[0] @ cv2.Rodrigues(y * pitch)[0] @ cv2.Rodrigues(x * roll)[0]
    assert np.allclose(rotation, pose["rotation"], atol=1e-5)
    assert np.all(np.diag(pose["covariance"]) > np.diag(pose["covariance_given_camera"]))
    assert calibration["grade"] == "determined"
    for name, (low, high) in calibration["interval_95"].items():
        assert (
            0.95 < low / calibration["intrinsics"][name] < 1.0 < high / calibration["intrinsics"][name] < 1.05
        )
    json.dumps(measured, allow_nan=False)


def test_points_come_when_asked_for(computing_api: Any, measured: dict[str, Any]) -> None:
    assert measured["points"] is None
    address = f"/v1/measurements/{measured['id']}"
    points = computing_api.client.get(address, params={"include": "points"}).json()["points"]
    assert {(p["column"], p["row"]) for p in points} == {(c, r) for c in range(9) for r in range(6)}
    assert {type(p["used"]) for p in points} == {bool}
    used = [math.hypot(p["residual_u_px"], p["residual_v_px"]) for p in points if p["used"]]
    reprojection = measured["calibration"]["reprojection"]
    assert len(used) == reprojection["points"]
    assert math.sqrt(np.mean(np.square(used))) == pytest.approx(reprojection["rms_px"], rel=1e-5)
    assert computing_api.client.get(address, params={"include": "everything"}).status_code == 422


def test_numbers_have_the_digits_that_their_uncertainty_supports(measured: dict[str, Any]) -> None:
    calibration = measured["calibration"]
    u = calibration["standard_uncertainty"]["fx_px"]
    assert u == float(f"{u:.4g}")
    places = 4 - math.floor(math.log10(u))
    assert calibration["intrinsics"]["fx_px"] == round(calibration["intrinsics"]["fx_px"], places)
    for value in (measured["duration_ms"], calibration["reprojection"]["rms_px"]):
        assert value == float(f"{value:.6g}")
    assert (
        max(len(text.strip("-0.")) for text in re.findall(r"-?[0-9]+[.][0-9]+", json.dumps(calibration))) < 12
    )


def test_session_intrinsics_leave_only_the_pose_to_find(computing_api: Any, board_png: bytes) -> None:
    session_id = computing_api.make_session(
        intrinsics={"fx_px": 2320, "fy_px": 2320, "cx_px": 1224, "cy_px": 1025, "k1": -0.1, "k2": 0.05}
    )
    measurement = computing_api.wait_for(computing_api.put_image(session_id, board_png).json()["id"])
    assert measurement["calibration"]["estimator"] == "given"
    assert measurement["calibration"]["intrinsics"] == {
        "fx_px": 2320,
        "fy_px": 2320,
        "cx_px": 1224,
        "cy_px": 1025,
    }
    assert set(measurement["calibration"]["standard_uncertainty"].values()) == {0.0}


def test_an_image_without_a_board_fails_with_advice(computing_api: Any, grey_png: bytes) -> None:
    measurement = computing_api.wait_for(
        computing_api.put_image(computing_api.make_session(), grey_png).json()["id"]
    )
    assert (measurement["status"], measurement["failure"]["code"]) == ("failed", "target_not_found")
    assert measurement["failure"]["detail"]
    assert measurement["failure"]["advice"]
    assert measurement["calibration"] is None


@pytest.mark.slow
def test_a_refused_view_keeps_its_points(computing_api: Any) -> None:
    target = TargetSpec("chessboard", 9, 6, 25.0)
    image = render(standard_scene(target, seed=3, tilt=0.0, clutter=0.0))
    png = cv2.imencode(".png", image)[1].tobytes()
    measurement = computing_api.wait_for(
        computing_api.put_image(computing_api.make_session(), png).json()["id"]
    )
    assert (measurement["status"], measurement["failure"]["code"]) == ("failed", "focal_not_observable")
    points = computing_api.client.get(f"/v1/measurements/{measurement['id']}?include=points").json()["points"]
    assert len(points) == 54
    assert {p["used"] for p in points} == {None}
    assert {p["residual_u_px"] for p in points} == {None}


def test_damaged_files_fail_and_the_service_goes_on(computing_api: Any, board_png: bytes) -> None:
    session_id = computing_api.make_session()
    half = board_png[: len(board_png) // 2]
    flipped = bytearray(board_png)
    flipped[len(flipped) // 2] ^= 0xFF
    for data in (half, bytes(flipped)):
        measurement = computing_api.wait_for(computing_api.put_image(session_id, data).json()["id"])
        assert (measurement["status"], measurement["failure"]["code"]) == ("failed", "undecodable_image")
        assert measurement["attempts"] == 1
    assert computing_api.client.get("/readyz").status_code == 200


def test_an_image_of_one_pixel_fails_gently(computing_api: Any) -> None:
    png = cv2.imencode(".png", np.zeros((1, 1), np.uint8))[1].tobytes()
    measurement = computing_api.wait_for(
        computing_api.put_image(computing_api.make_session(), png).json()["id"]
    )
    assert measurement["failure"]["code"] == "target_not_found"


def test_retry_computes_again_with_the_session_as_it_is_now(computing_api: Any, board_png: bytes) -> None:
    session_id = computing_api.make_session()
    first = computing_api.wait_for(computing_api.put_image(session_id, board_png).json()["id"])
    lens = {"focal_length_mm": 8.0, "pixel_pitch_um": 3.45}
    computing_api.client.patch(f"/v1/sessions/{session_id}", json={"lens": lens})
    retried = computing_api.client.post(f"/v1/measurements/{first['id']}/retry")
    assert retried.status_code == 202
    assert retried.headers["location"] == f"/v1/measurements/{first['id']}"
    assert retried.json()["status"] in ("queued", "running")
    again = computing_api.wait_for(first["id"])
    assert again["received_at"] == first["received_at"]
    assert again["finished_at"] > first["finished_at"]
    assert again["attempts"] == 1
    assert again["calibration"]["intrinsics"] != first["calibration"]["intrinsics"]


def test_measurements_are_listed_and_filtered(computing_api: Any, grey_png: bytes, board_png: bytes) -> None:
    session_id = computing_api.make_session()
    ids = [
        computing_api.wait_for(computing_api.put_image(session_id, data, pose_id).json()["id"])["id"]
        for data, pose_id in ((grey_png, "P1"), (board_png, "P1"), (board_png, "P2"))
    ]
    address = f"/v1/sessions/{session_id}/measurements"

    def listed(**query: str) -> list[str]:
        return [item["id"] for item in computing_api.client.get(address, params=query).json()["items"]]

    assert listed() == ids
    assert listed(status="succeeded") == ids[1:]
    assert listed(status="failed") == ids[:1]
    assert listed(status="queued") == []
    assert listed(pose_id="P1") == ids[:2]
    assert listed(pose_id="P1", status="succeeded") == ids[1:2]
    assert listed(pose_id="P3") == []
    single = computing_api.client.get(f"/v1/measurements/{ids[1]}").json()
    assert computing_api.client.get(address).json()["items"][1] == single
    counts = computing_api.client.get(f"/v1/sessions/{session_id}").json()["counts"]
    assert counts == {"queued": 0, "running": 0, "succeeded": 2, "failed": 1, "duplicates": 0}


def test_a_missing_original_is_a_failure_with_its_own_code(computing_api: Any, grey_png: bytes) -> None:
    session_id = computing_api.make_session()
    data = grey_png + b"\0"
    measurement = computing_api.wait_for(computing_api.put_image(session_id, data).json()["id"])
    computing_api.installation.blobs.path(measurement["sha256"]).unlink()
    image = computing_api.client.get(f"/v1/measurements/{measurement['id']}/image")
    assert (image.status_code, image.json()["code"]) == (404, "original_missing")
    computing_api.client.post(f"/v1/measurements/{measurement['id']}/retry")
    assert computing_api.wait_for(measurement["id"])["failure"]["code"] == "original_missing"


def test_a_real_photograph_is_measured(computing_api: Any, data_folder: Path) -> None:
    data = (data_folder / "opencv_samples" / "left01.jpg").read_bytes()
    response = computing_api.client.post(
        f"/v1/sessions/{computing_api.make_session()}/images",
        files={"image": ("left01.jpg", data, "image/jpeg")},
        data={"pose_id": "P1"},
    )
    assert response.json()["sha256"] == hashlib.sha256(data).hexdigest()
    measurement = computing_api.wait_for(response.json()["id"])
    assert measurement["status"] == "succeeded"
    # f of the multi-view reference is 532; one view of a bent board may be 5 % off.
    assert measurement["calibration"]["intrinsics"]["fx_px"] == pytest.approx(532, rel=0.05)


def test_events_show_each_step_until_the_session_is_gone(computing_api: Any, grey_png: bytes) -> None:
    session_id = computing_api.make_session()
    computing_api.wait_for(computing_api.put_image(session_id, grey_png).json()["id"])
    with computing_api.client.stream("GET", f"/v1/sessions/{session_id}/events") as response:
        assert response.headers["content-type"].startswith("text/event-stream")
        events = read_events(response)
        first = next(events)
        assert (first.name, first.data["counts"]["failed"], first.data["pending"]) == ("progress", 1, 0)
        sent = computing_api.put_image(session_id, grey_png, "P2").json()["id"]
        steps = ["queued", "running", "failed"]
        for event in events:
            assert (event.name, event.data["measurement_id"], event.data["pose_id"]) == (
                "measurement",
                sent,
                "P2",
            )
            assert event.data["status"] in steps, "no step comes twice, or after a later one"
            steps = steps[steps.index(event.data["status"]) + 1 :]
            if not steps:
                break
        assert event.data["counts"]["failed"] == 2
        computing_api.client.delete(f"/v1/sessions/{session_id}")
        assert [(event.name, event.data) for event in events] == [("deleted", {"session_id": session_id})]
