"""Images that do not show what was asked for: each refused by its own code, with what to do about it."""

from __future__ import annotations

import dataclasses
import math
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest

from core import TargetSpec
from core.simulation import render
from core.targets.specification import KINDS
from tests.support.image.images import encode
from tests.support.simulation.scenes import standard_scene

TARGETS = {
    "chessboard": TargetSpec("chessboard", 9, 6, 25.0),
    "charuco": TargetSpec("charuco", 8, 5, 28.0, 20.0, "DICT_5X5_100"),
    "circles": TargetSpec("circles", 9, 6, 24.0),
    "asymmetric_circles": TargetSpec("asymmetric_circles", 4, 11, 16.0),
    "aprilgrid": TargetSpec("aprilgrid", 6, 4, 36.0, 27.0),
}
"""One of each kind."""
CHARUCO = TARGETS["charuco"]
SLOW = pytest.mark.slow


@cache
def view(kind: str) -> Any:
    """A rendered image of the target of this kind."""
    scene = standard_scene(TARGETS[kind], seed=5, tilt=math.radians(30.0), clutter=0.0)
    return render(dataclasses.replace(scene, width_px=1224, height_px=1025, camera=_half(scene.camera)))


def _half(camera: Any) -> Any:
    return dataclasses.replace(
        camera,
        fx_px=camera.fx_px / 2.0,
        fy_px=camera.fy_px / 2.0,
        cx_px=(camera.cx_px - 0.5) / 2.0,
        cy_px=(camera.cy_px - 0.5) / 2.0,
    )


def measure(api: Any, target: TargetSpec, image: Any) -> dict[str, Any]:
    session_id = api.make_session(api.make_target(**dataclasses.asdict(target)))
    document: dict[str, Any] = api.wait_for(api.put_image(session_id, encode(".png", image)).json()["id"])
    return document


@pytest.mark.slow
@pytest.mark.parametrize(
    "shown", ["charuco", *(pytest.param(k, marks=SLOW) for k in KINDS if k != "charuco")]
)
def test_no_kind_is_taken_for_another(computing_api: Any, shown: str) -> None:
    """In one session that looks for all of them: the one in view is found, and nothing else."""
    targets = {
        kind: computing_api.make_target(**dataclasses.asdict(target)) for kind, target in TARGETS.items()
    }
    session_id = computing_api.make_session(*targets.values())
    response = computing_api.put_image(session_id, encode(".png", view(shown)))
    measurement = computing_api.wait_for(response.json()["id"])
    assert (measurement["status"], measurement["target_id"]) == ("succeeded", targets[shown])
    assert measurement["siblings"] == []


@pytest.mark.parametrize(
    ("shown", "changes"),
    [
        pytest.param("chessboard", {"columns": 8}, marks=SLOW),
        pytest.param("chessboard", {"rows": 8}, marks=SLOW),
        ("charuco", {"dictionary": "DICT_6X6_250"}),
        pytest.param("charuco", {"legacy_layout": True}, marks=SLOW),
        pytest.param("circles", {"columns": 8}, marks=SLOW),
        pytest.param("asymmetric_circles", {"rows": 9}, marks=SLOW),
        pytest.param("aprilgrid", {"columns": 5}, marks=SLOW),
    ],
)
def test_another_size_or_dictionary_is_refused_with_advice(
    computing_api: Any, shown: str, changes: dict[str, Any]
) -> None:
    wanted = dataclasses.replace(TARGETS[shown], **changes)
    measurement = measure(computing_api, wanted, view(shown))
    assert measurement["status"] == "failed"
    assert measurement["failure"]["code"] in ("target_mismatch", "target_not_found")
    assert measurement["failure"]["detail"]
    assert measurement["failure"]["advice"]
    assert measurement["calibration"] is None


@pytest.mark.parametrize("kind", ["charuco", pytest.param("aprilgrid", marks=SLOW)])
def test_a_mirrored_print_is_identified(computing_api: Any, kind: str) -> None:
    measurement = measure(computing_api, TARGETS[kind], np.ascontiguousarray(view(kind)[:, ::-1]))
    assert (measurement["status"], measurement["failure"]["code"]) == ("failed", "target_mirrored")
    assert measurement["failure"]["advice"]


def test_a_target_too_small_to_be_identified_is_refused_before_any_image(computing_api: Any) -> None:
    wanted = {"name": "x", "kind": "chessboard", "columns": 2, "rows": 5, "pitch_mm": 25.0}
    response = computing_api.client.post("/v1/targets", json=wanted)
    assert (response.status_code, response.json()["code"]) == (422, "invalid_target")
    assert response.json()["advice"]


def test_a_third_of_a_board_hidden_costs_points_and_not_the_pose(computing_api: Any) -> None:
    scene = standard_scene(CHARUCO, seed=5, tilt=math.radians(30.0), clutter=0.0)
    whole = measure(computing_api, CHARUCO, view("charuco"))
    points = scene.points_px / 2.0
    hand = view("charuco").copy()
    left = points[:, 0].min() + 0.3 * np.ptp(points[:, 0])
    cv2.rectangle(hand, (0, 0), (round(left), hand.shape[0]), 140, cv2.FILLED)
    partly = measure(computing_api, CHARUCO, hand)
    assert (partly["status"], partly["labelling"]) == ("succeeded", "absolute")
    count = partly["calibration"]["reprojection"]["points"]
    assert 0.5 * CHARUCO.size < count < whole["calibration"]["reprojection"]["points"]
    true = np.linalg.inv(scene.T_camera_target)[:3, 3]
    pose = partly["calibration"]["pose"]
    error = np.abs(np.array(pose["position_mm"]) - true)
    assert np.all(error < 5.0 * np.sqrt(np.diag(np.array(pose["covariance"]))[:3]))
