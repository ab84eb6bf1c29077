"""From the printed sheet to the camera's pose, over HTTP, for every kind of target; and the same of real photographs.

The sheet is the PDF that is printed, rasterised by a program that nobody here wrote, and photographed obliquely. Of
staggered dots and AprilGrids there are no photographs.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pypdfium2
import pytest

from app.printing import Sheet, draw_sheet, to_pdf
from core import Camera, TargetSpec
from core.geometry.se3 import invert, so3_exp, so3_log, transform
from core.targets.specification import KINDS
from tests.support.image.images import encode
from tests.support.simulation.robots.tool_poses import tool_pose

CAMERA = Camera(1450.0, 1450.0, 646.0, 472.0)
SIZE_PX = (1280, 960)
_FINER = 3  # samples along each side of a pixel
_DPI = 381.0
_BACKGROUND = 90.0

PRINTED = {
    "chessboard": (TargetSpec("chessboard", 9, 6, 25.0), {}),
    "charuco": (TargetSpec("charuco", 8, 5, 28.0, 20.0, "DICT_5X5_100"), {}),
    "circles": (TargetSpec("circles", 9, 6, 24.0), {"origin_dot": 1.5}),
    "asymmetric_circles": (TargetSpec("asymmetric_circles", 4, 11, 16.0), {}),
    "aprilgrid": (TargetSpec("aprilgrid", 6, 4, 36.0, 27.0), {}),
}


def photograph(sheet: Sheet, T_camera_target: Any, seed: int) -> bytes:
    """A PNG of a sheet before a camera without distortion: warped, averaged over pixels, blurred, with noise."""
    page = pypdfium2.PdfDocument(to_pdf(sheet))[0]
    levels = np.ascontiguousarray(page.render(scale=_DPI / 72.0, grayscale=True).to_numpy().squeeze())
    mm_per_px = np.array([sheet.paper.width_mm, sheet.paper.height_mm]) / levels.shape[::-1]
    to_target = np.array(
        [
            [mm_per_px[0], 0.0, 0.5 * mm_per_px[0] - sheet.origin[0]],
            [0.0, mm_per_px[1], 0.5 * mm_per_px[1] - sheet.origin[1]],
            [0.0, 0.0, 1.0],
        ]
    )
    plane = T_camera_target[:3, [0, 1, 3]]
    finer = np.diag([_FINER, _FINER, 1.0])
    finer[:2, 2] = 0.5 * (_FINER - 1)  # a pixel's middle is that of its samples
    size = tuple(_FINER * side for side in SIZE_PX)
    seen = cv2.warpPerspective(
        25.0 + 0.75 * levels.astype(np.float32),
        finer @ CAMERA.matrix @ plane @ to_target,
        size,
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=_BACKGROUND,
    )
    image = cv2.GaussianBlur(cv2.resize(seen, SIZE_PX, interpolation=cv2.INTER_AREA), (0, 0), 0.7)
    image += np.random.default_rng(seed).normal(0.0, 6.0, image.shape)
    return encode(".png", np.clip(np.rint(image), 0, 255).astype(np.uint8))


def oblique_view(target: TargetSpec) -> Any:
    """T_camera_target of a camera that looks at a sheet from half a metre, turned by some 35°."""
    rotation = so3_exp(math.radians(35.0) * np.array([0.6, 0.8, 0.0])) @ so3_exp(np.array([0.0, 0.0, 0.2]))
    middle = target.points_target().mean(axis=0)
    return transform(rotation, np.array([5.0, -8.0, 480.0]) - rotation @ middle)


@pytest.mark.parametrize(
    "kind", ["charuco", *(pytest.param(k, marks=pytest.mark.slow) for k in KINDS if k != "charuco")]
)
def test_a_printed_sheet_gives_the_pose(computing_api: Any, kind: str) -> None:
    target, extras = PRINTED[kind]
    T_camera_target = oblique_view(target)
    data = photograph(draw_sheet(target, **extras), T_camera_target, seed=7)
    made = computing_api.client.post("/v1/targets", json={"name": kind, **dataclasses.asdict(target)})
    assert made.status_code == 201, made.text
    session_id = computing_api.make_session(made.json()["id"])
    measurement = computing_api.wait_for(computing_api.put_image(session_id, data).json()["id"])
    assert (measurement["status"], measurement["failure"]) == ("succeeded", None)
    assert measurement["labelling"] == "absolute"
    calibration = measurement["calibration"]
    reprojection = calibration["reprojection"]
    assert reprojection["points"] + reprojection["rejected"] == target.size
    assert reprojection["rejected"] <= 2
    T = invert(T_camera_target)
    pose = calibration["pose"]
    error = np.concatenate(
        [np.array(pose["position_mm"]) - T[:3, 3], so3_log(np.array(pose["rotation"]) @ T[:3, :3].T)]
    )
    distance = error @ np.linalg.solve(np.array(pose["covariance"]), error)
    # χ² with six degrees of freedom exceeds 27.9 once in ten thousand times.
    assert distance < 27.9


def measure_all(api: Any, session_id: str, files: list[Path]) -> list[dict[str, Any]]:
    ids = [api.put_image(session_id, file.read_bytes(), file.stem).json()["id"] for file in files]
    return [api.wait_for(measurement_id) for measurement_id in ids]


def angle_between(one: Any, other: Any) -> float:
    return math.degrees(float(np.linalg.norm(so3_log(np.asarray(one).T @ np.asarray(other)))))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "target", "focal_px", "within_deg"),
    [
        ("charuco", TargetSpec("charuco", 4, 6, 36.195, 18.256, "DICT_6X6_250"), 1361.0, 0.5),
        # Dots of 3 px seen from straight ahead, where a tilt changes next to nothing.
        ("circles_10x10", TargetSpec("circles", 10, 10, 25.4), 541.5, 3.0),
    ],
)
def test_photographs_turn_as_their_robot_did(
    computing_api: Any,
    data_folder: Path,
    folder: str,
    target: TargetSpec,
    focal_px: float,
    within_deg: float,
) -> None:
    """robot_cal_tools' sets: few views determine the focal length alone; all of them do, and then each view its pose.

    However the camera is mounted, between two images it turns by the angle that the robot's tool does.
    """
    api, source = computing_api, data_folder / "robot_cal_tools" / folder
    files = sorted((source / "images").glob("*.png"), key=lambda file: int(file.stem))
    session_id = api.make_session(api.make_target(**dataclasses.asdict(target)))
    for measurement in measure_all(api, session_id, files):
        assert (
            measurement["status"] == "succeeded" or measurement["failure"]["code"] == "focal_not_observable"
        )
        assert measurement["labelling"] == "absolute"
        quality = measurement["capture_quality"]
        assert 0.0 < quality["coverage_fraction"] < 1.0
        # Dots of 3 px have hardly room for their edges to reach black and white; then there is no contrast to report.
        assert (folder == "circles_10x10" and quality["contrast"] is None) or quality["contrast"] > 0.1
    (group,) = api.client.get(f"/v1/sessions/{session_id}/intrinsics").json()["groups"]
    assert group["image_count"] == len(files)
    assert group["intrinsics"]["fx_px"] == pytest.approx(focal_px, rel=0.012)
    lens = {**group["intrinsics"], **group["distortion"]}
    assert api.client.patch(f"/v1/sessions/{session_id}", json={"intrinsics": lens}).status_code == 200
    rotations = []
    for measurement in api.client.get(f"/v1/sessions/{session_id}/measurements").json()["items"]:
        assert api.client.post(f"/v1/measurements/{measurement['id']}/retry").status_code == 202
        again = api.wait_for(measurement["id"])
        assert (again["status"], again["calibration"]["estimator"]) == ("succeeded", "given")
        rotations.append(again["calibration"]["pose"]["rotation"])
    tools = [tool_pose(source / "poses" / f"{file.stem}.yaml")[:3, :3] for file in files]
    turned = [angle_between(rotations[0], rotation) for rotation in rotations[1:]]
    expected = [angle_between(tools[0], tool) for tool in tools[1:]]
    assert max(expected) > 20.0
    np.testing.assert_allclose(turned, expected, rtol=0.0, atol=within_deg)


def test_a_photographed_chessboard_gives_its_pose(computing_api: Any, data_folder: Path) -> None:
    session_id = computing_api.make_session()
    files = [data_folder / "opencv_samples" / f"left{number}.jpg" for number in ("02", "03", "12")]
    for measurement in measure_all(computing_api, session_id, files):
        assert measurement["status"] == "succeeded"
        # f of the multi-view reference is 532; one view of a bent board may be 5 % off.
        assert measurement["calibration"]["intrinsics"]["fx_px"] == pytest.approx(532, rel=0.05)
        assert 300.0 < np.linalg.norm(measurement["calibration"]["pose"]["position_mm"]) < 500.0


@pytest.mark.slow
def test_a_photographed_charuco_board_seen_from_ahead_keeps_its_points(
    computing_api: Any, data_folder: Path
) -> None:
    """OpenCV's sample: a view so flat determines the focal length weakly, and better once the lens is stated."""
    target = TargetSpec("charuco", 4, 6, 40.0, 20.0, "DICT_6X6_250")
    session_id = computing_api.make_session(computing_api.make_target(**dataclasses.asdict(target)))
    (measurement,) = measure_all(
        computing_api, session_id, [data_folder / "opencv_samples" / "choriginal.jpg"]
    )
    calibration = measurement["calibration"]
    assert (calibration["grade"], measurement["labelling"]) == ("weak", "absolute")
    assert "focal_weakly_observable" in {w["code"] for w in calibration["warnings"]}
    alone = calibration["observability"]["focal_relative_uncertainty"]
    address = f"/v1/measurements/{measurement['id']}"
    points = computing_api.client.get(address, params={"include": "points"}).json()["points"]
    assert 12 <= len(points) <= target.size
    assert computing_api.client.get(f"{address}/overlay").status_code == 200
    lens = {"focal_length_mm": 516.0, "pixel_pitch_um": 1000.0}
    computing_api.client.patch(f"/v1/sessions/{session_id}", json={"lens": lens})
    computing_api.client.post(f"{address}/retry")
    stated = computing_api.wait_for(measurement["id"])["calibration"]["observability"]
    assert stated["focal_relative_uncertainty"] < alone
