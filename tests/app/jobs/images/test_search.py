"""Images that name no target: the worker searches them for all of the session's, and each found one is measured."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import cv2
import numpy as np
import pytest
import sqlalchemy as sa

from app.records.tables import Measurement
from core import TargetSpec
from core.geometry.se3 import invert
from core.simulation import render
from tests.support.simulation.room_corner import SIZE_PX, Corner, png

CHESSBOARD = TargetSpec("chessboard", 8, 5, 18.0)


SMALLER = TargetSpec("chessboard", 7, 4, 20.0)


CHARUCO = TargetSpec("charuco", 6, 5, 22.0, marker_mm=16.0, dictionary="DICT_5X5_100")


OTHER_MARKERS = TargetSpec("charuco", 5, 5, 22.0, marker_mm=16.0, dictionary="DICT_4X4_50")


def make_targets(api: Any, *specs: TargetSpec) -> list[str]:
    return [api.make_target(**dataclasses.asdict(spec)) for spec in specs]


@pytest.fixture(scope="module")
def corner() -> Corner:
    return Corner(CHESSBOARD, CHARUCO)


@pytest.fixture(scope="module")
def image(corner: Corner) -> bytes:
    return corner.image(corner.view(turn=0.3), seed=3)


@pytest.mark.parametrize(
    "specs",
    [
        pytest.param((CHESSBOARD, CHARUCO), id="kinds"),
        pytest.param((OTHER_MARKERS, CHARUCO), id="ids", marks=pytest.mark.slow),
        pytest.param((SMALLER, CHESSBOARD), id="sizes", marks=pytest.mark.slow),
    ],
)
def test_both_grids_of_a_corner_are_measured(computing_api: Any, specs: tuple[TargetSpec, ...]) -> None:
    api, corner = computing_api, Corner(*specs)
    T_camera_ahead = corner.view(turn=0.2, lift_mm=20.0)
    data = corner.image(T_camera_ahead, seed=1)
    absent, *targets = make_targets(api, TargetSpec("circles", 6, 5, 20.0), *specs)
    session_id = api.make_session(absent, *targets)
    accepted = api.put_image(session_id, data, cycle=2, joint_angles_deg="1,2", focus_group="near")
    assert (accepted.status_code, accepted.json()["target_id"]) == (202, None)
    first = api.wait_for(accepted.json()["id"])
    both = api.measurements(session_id)
    assert [m["target_id"] for m in both] == targets
    assert both[0] == first
    assert [m["siblings"] for m in both] == [[both[1]["id"]], [both[0]["id"]]]
    same = (
        "pose_id",
        "sha256",
        "cycle",
        "joint_angles_deg",
        "focus_group",
        "received_at",
        "bytes",
        "filename",
    )
    assert [both[1][name] for name in same] == [both[0][name] for name in same]
    with api.installation.database.read() as records:
        makers = records.scalars(
            sa.select(Measurement.made_by).where(Measurement.session_id == session_id)
        ).all()
    assert len(makers) == 2
    assert makers[0] == makers[1] is not None
    assert [m["attempts"] for m in both] == [1, 1]
    assert (
        both[0]["duration_ms"] > both[1]["duration_ms"] > 0.0
    )  # the first one's holds decoding and searching
    for measurement, scene in zip(both, corner.scenes(T_camera_ahead), strict=True):
        assert measurement["status"] == "succeeded"
        assert api.client.get(f"/v1/measurements/{measurement['id']}").json() == measurement
        assert measurement["labelling"] in ("absolute", "up_to_symmetry")
        quality = measurement["capture_quality"]
        tilt = measurement["calibration"]["observability"]["tilt_deg"]
        assert quality["tilt_deg"] == pytest.approx(tilt, abs=1e-9)
        pose = measurement["calibration"]["pose"]
        error = np.array(pose["position_mm"]) - invert(scene.T_camera_target)[:3, 3]
        if measurement["labelling"] == "absolute":
            # Five standard uncertainties: one image of one seed, which must not fail by mere chance.
            assert np.all(np.abs(error) < 5.0 * np.sqrt(np.diag(pose["covariance"])[:3]))
        for ending in ("image", "overlay"):
            assert api.client.get(f"/v1/measurements/{measurement['id']}/{ending}").status_code == 200
    counts = api.client.get(f"/v1/sessions/{session_id}").json()["counts"]
    assert counts == {"queued": 0, "running": 0, "succeeded": 2, "failed": 0, "duplicates": 0}
    again = api.put_image(session_id, data)
    assert (again.status_code, again.json()) == (200, first)
    for measurement in both:
        named = api.put_image(session_id, data, target_id=measurement["target_id"])
        assert (named.status_code, named.json()) == (200, measurement)
    ask = {"images": [{"pose_id": "P1", "sha256": first["sha256"]}]}
    missing = api.client.post(f"/v1/sessions/{session_id}/images/missing", json=ask).json()
    assert missing == {"missing": []}
    assert api.client.delete(f"/v1/sessions/{session_id}").status_code == 204
    assert not api.installation.blobs.path(first["sha256"]).exists()


def test_a_target_found_is_measured_as_one_that_is_named(computing_api: Any, image: bytes) -> None:
    api, targets = computing_api, make_targets(computing_api, CHESSBOARD, CHARUCO)
    named, searched = api.make_session(*targets), api.make_session(*targets)
    by_name = [
        api.wait_for(api.put_image(named, image, target_id=target_id).json()["id"]) for target_id in targets
    ]
    api.wait_for(api.put_image(searched, image).json()["id"])
    by_search = api.measurements(searched)
    for one, other in zip(by_name, by_search, strict=True):
        for field in ("calibration", "labelling", "capture_quality", "target_id", "status"):
            assert one[field] == other[field]
        points = [
            api.client.get(f"/v1/measurements/{m['id']}?include=points").json()["points"]
            for m in (one, other)
        ]
        assert points[0] == points[1]
    assert api.client.get(f"/v1/measurements/{by_name[0]['id']}").json()["siblings"] == [by_name[1]["id"]]


def test_what_was_measured_by_name_joins_as_a_sibling(computing_api: Any, image: bytes) -> None:
    api, targets = computing_api, make_targets(computing_api, CHESSBOARD, CHARUCO)
    session_id = api.make_session(*targets)
    by_name = api.wait_for(api.put_image(session_id, image, target_id=targets[0]).json()["id"])
    searched = api.wait_for(api.put_image(session_id, image).json()["id"])
    assert (searched["status"], searched["target_id"]) == ("succeeded", targets[1])
    assert searched["siblings"] == [by_name["id"]]
    unchanged = api.client.get(f"/v1/measurements/{by_name['id']}").json()
    assert unchanged == {**by_name, "siblings": [searched["id"]]}


@pytest.mark.slow
def test_nothing_left_to_measure_is_said_and_nothing_is_lost(computing_api: Any, corner: Corner) -> None:
    api, targets = computing_api, make_targets(computing_api, CHESSBOARD, CHARUCO)
    ahead, _ = corner.scenes(corner.view(turn=0.1))
    data = png(render(ahead))
    session_id = api.make_session(*targets)
    by_name = api.wait_for(api.put_image(session_id, data, target_id=targets[0]).json()["id"])
    searched = api.wait_for(api.put_image(session_id, data).json()["id"])
    assert (searched["status"], searched["failure"]["code"]) == ("failed", "target_already_measured")
    assert searched["failure"]["advice"]
    assert searched["target_id"] is None
    assert searched["siblings"] == [by_name["id"]]
    assert [m["id"] for m in api.measurements(session_id)] == [by_name["id"], searched["id"]]
    assert api.client.get(f"/v1/sessions/{session_id}/intrinsics").status_code == 200


def test_an_image_of_none_says_what_was_looked_for(computing_api: Any, image: bytes, grey_png: bytes) -> None:
    api, targets = computing_api, make_targets(computing_api, SMALLER, OTHER_MARKERS, CHESSBOARD, CHARUCO)
    session_id = api.make_session(*targets[:2])
    nothing = api.wait_for(api.put_image(session_id, grey_png).json()["id"])
    assert (nothing["status"], nothing["failure"]["code"]) == ("failed", "target_not_found")
    assert nothing["target_id"] is nothing["labelling"] is nothing["capture_quality"] is None
    for word in ("chessboard 7 x 4", "charuco 5 x 5", *targets[:2]):
        assert word in nothing["failure"]["detail"]
    other = api.wait_for(api.put_image(session_id, image).json()["id"])
    assert (other["failure"]["code"], other["target_id"]) == ("target_mismatch", None)
    assert "chessboard 7 x 4" in other["failure"]["detail"]
    problem = api.client.get(f"/v1/sessions/{session_id}/repeatability")
    assert (problem.status_code, problem.json()["code"]) == (409, "no_usable_images")
    # Once the session knows what it shows, the same image is searched anew.
    changed = api.client.patch(f"/v1/sessions/{session_id}", json={"target_ids": targets})
    assert changed.status_code == 200
    found = api.wait_for(other["id"])
    assert (found["status"], found["target_id"]) == ("succeeded", targets[2])
    (sibling,) = found["siblings"]
    assert api.client.get(f"/v1/measurements/{sibling}").json()["target_id"] == targets[3]


def test_boards_that_look_the_same_are_not_guessed(computing_api: Any, corner: Corner) -> None:
    api = computing_api
    targets = make_targets(api, CHESSBOARD, dataclasses.replace(CHESSBOARD, pitch_mm=9.0))
    ahead, _ = corner.scenes(corner.view())
    measurement = api.wait_for(api.put_image(api.make_session(*targets), png(render(ahead))).json()["id"])
    assert (measurement["status"], measurement["failure"]["code"]) == ("failed", "target_ambiguous")
    assert measurement["target_id"] is None
    assert measurement["siblings"] == []
    assert "target_id" in measurement["failure"]["advice"]
    detail = measurement["failure"]["detail"]
    assert "None of" not in detail
    for words in ("look the same", *targets):
        assert words in detail


def test_a_refused_view_is_shown_all_the_same(computing_api: Any, corner: Corner) -> None:
    api, targets = computing_api, make_targets(computing_api, CHARUCO, CHESSBOARD)
    T = np.eye(4)
    T[:3, 3] = -70.0, -40.0, 420.0
    flat, _ = corner.scenes(T)
    measurement = api.wait_for(api.put_image(api.make_session(*targets), png(render(flat))).json()["id"])
    assert (measurement["failure"]["code"], measurement["target_id"]) == ("focal_not_observable", targets[1])
    assert measurement["labelling"] is not None
    assert measurement["capture_quality"]["warnings"]
    points = api.client.get(f"/v1/measurements/{measurement['id']}?include=points").json()["points"]
    assert len(points) == CHESSBOARD.size


def test_a_damaged_file_is_no_target(computing_api: Any, image: bytes) -> None:
    targets = make_targets(computing_api, CHARUCO, CHESSBOARD)
    response = computing_api.put_image(computing_api.make_session(*targets), image[: len(image) // 2])
    measurement = computing_api.wait_for(response.json()["id"])
    assert (measurement["failure"]["code"], measurement["target_id"]) == ("undecodable_image", None)


def test_the_quality_is_that_of_the_image(computing_api: Any, corner: Corner, image: bytes) -> None:
    targets = make_targets(computing_api, CHESSBOARD, CHARUCO)
    session_id = computing_api.make_session(*targets)
    first = computing_api.wait_for(computing_api.put_image(session_id, image).json()["id"])
    quality = first["capture_quality"]
    view = corner.view(turn=0.3)
    assert quality["tilt_deg"] == pytest.approx(math.degrees(math.acos(abs(view[2, 2]))), abs=1.0)
    outline = cv2.convexHull(corner.scenes(view)[0].points_px.astype(np.float32))
    share = cv2.contourArea(outline) / math.prod(SIZE_PX)
    assert quality["coverage_fraction"] == pytest.approx(share, rel=0.01)
    assert 2.0 < quality["edge_width_px"] < 4.0  # 10-90 % of a Gaussian of 1 px and of a pixel's square: 2.7
    assert quality["saturated_fraction"] == quality["clipped_fraction"] == 0.0
