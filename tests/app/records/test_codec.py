"""A calibration survives its row to the last bit, and its document speaks degrees."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

from app.records.codec import (
    decode_markers,
    decode_stack,
    encode_calibration,
    encode_refused,
    points_documents,
)
from app.records.outcome import Provenance
from core.calibration.result import Calibration, CameraPose, Observability, Reprojection
from core.errors import Advisory
from core.geometry.camera import Camera
from core.targets.quality_result import CaptureQuality
from core.targets.specification import GridPoints, TargetSpec

TARGET = TargetSpec("chessboard", 7, 5, 12.5)
PROVENANCE = Provenance("1.2.3", "0" * 64, {"lens": None})


@pytest.fixture
def calibration() -> Calibration:
    """Random numbers in every field: what each means does not matter here, that it survives does."""
    rng = np.random.default_rng(7)
    count = 31

    def covariance(size: int) -> np.ndarray:
        root = rng.normal(size=(size, size))
        return root @ root.T

    points = GridPoints(
        target=TARGET,
        image_width_px=640,
        image_height_px=480,
        column=rng.integers(0, 7, count),
        row=rng.integers(0, 5, count),
        points_px=rng.normal(300, 100, (count, 2)),
        standard_uncertainty_px=rng.uniform(0.01, 0.1, count),
        warnings=(Advisory("board_symmetry_unresolved", "Two ends look the same.", "Keep one."),),
    )
    return Calibration(
        estimator="per_image",
        initialisation="vanishing_point",
        image_width_px=640,
        image_height_px=480,
        camera=Camera.from_array(100.0 + rng.normal(size=9)),
        T_camera_target=rng.normal(size=(4, 4)),
        covariance=covariance(15),
        pose=CameraPose(
            position_mm=rng.normal(size=3),
            rotation=rng.normal(size=(3, 3)),
            roll_pitch_yaw=np.array([np.pi / 2, -np.pi / 6, np.pi]),
            roll_pitch_yaw_standard_uncertainty=np.array([np.pi / 180, 0.0, 1e-3]),
            covariance=covariance(6),
            covariance_given_camera=covariance(6),
        ),
        reprojection=Reprojection(rms_px=0.1, mean_px=0.08, std_px=0.03, max_px=0.3, points=30, rejected=1),
        observability=Observability(0.01, 1234.5, np.pi / 4, ("k3", "p1"), 0.25),
        warnings=(Advisory("w", "d", None), *points.warnings),
        points=points,
        residuals_px=rng.normal(size=(count, 2)),
        used=rng.uniform(size=count) > 0.1,
        inflation=1.5,
    )


def assert_same(left: Any, right: Any) -> None:
    if dataclasses.is_dataclass(left):
        assert type(left) is type(right)
        for field in dataclasses.fields(left):
            assert_same(getattr(left, field.name), getattr(right, field.name))
    elif isinstance(left, np.ndarray):
        np.testing.assert_array_equal(left, right)
    else:
        assert left == right


def assert_points(row: dict[str, Any], points: GridPoints) -> None:
    """The row has the points, each with its uncertainty, and their warnings."""
    decoded = decode_stack([row["points"]], [TARGET], [0], 640, 480).view(0)
    assert decoded == points
    np.testing.assert_array_equal(decoded.standard_uncertainty_px, points.standard_uncertainty_px)
    assert (decoded.image_width_px, decoded.image_height_px) == (640, 480)
    assert tuple(Advisory(**one) for one in row["points_warnings"]) == points.warnings


def test_nothing_is_lost(calibration: Calibration) -> None:
    row = encode_calibration(calibration, PROVENANCE)
    document = json.loads(json.dumps(row["calibration"], allow_nan=False))
    camera = Camera.from_array(np.array([*document["intrinsics"].values(), *document["distortion"].values()]))
    assert_same(camera, calibration.camera)
    pose = document["pose"]
    for stored, exact in (
        (document["T_camera_target"], calibration.T_camera_target),
        (pose["position_mm"], calibration.pose.position_mm),
        (pose["rotation"], calibration.pose.rotation),
        (pose["covariance"], calibration.pose.covariance),
        (pose["covariance_given_camera"], calibration.pose.covariance_given_camera),
    ):
        np.testing.assert_array_equal(stored, exact)
    fx_interval, fy_interval = calibration.focal_interval_95
    assert document["grade"] == calibration.grade == "determined"
    assert document["interval_95"] == {"fx_px": list(fx_interval), "fy_px": list(fy_interval)}
    assert_points(row, calibration.points)
    documents = points_documents(row["points"])
    residuals_px = [[point["residual_u_px"], point["residual_v_px"]] for point in documents]
    np.testing.assert_array_equal(residuals_px, calibration.residuals_px)
    np.testing.assert_array_equal([point["used"] for point in documents], calibration.used)
    assert (row["core_version"], row["input_sha256"], row["settings"]) == ("1.2.3", "0" * 64, {"lens": None})


def test_no_second_pose_stays_none(calibration: Calibration) -> None:
    observability = dataclasses.replace(calibration.observability, ambiguity_log_likelihood_ratio=None)
    row = encode_calibration(dataclasses.replace(calibration, observability=observability), PROVENANCE)
    assert row["calibration"]["observability"]["ambiguity_log_likelihood_ratio"] is None


def test_the_document_has_degrees_where_it_says_so(calibration: Calibration) -> None:
    document = encode_calibration(calibration, PROVENANCE)["calibration"]
    pose = document["pose"]
    assert [pose[name] for name in ("roll_deg", "pitch_deg", "yaw_deg")] == pytest.approx(
        [90.0, -30.0, 180.0]
    )
    assert pose["standard_uncertainty"]["roll_deg"] == pytest.approx(1.0)
    assert pose["covariance"] == calibration.pose.covariance.tolist()
    assert document["observability"]["tilt_deg"] == pytest.approx(45.0)
    assert document["standard_uncertainty"]["k1"] == pytest.approx(np.sqrt(calibration.covariance[4, 4]))


def test_a_refusal_keeps_its_points(calibration: Calibration) -> None:
    row = encode_refused(calibration.points, PROVENANCE)
    assert row["calibration"] is None
    assert_points(row, calibration.points)
    documents = points_documents(row["points"])
    assert len(documents) == 31
    assert {d["used"] for d in documents} == {d["residual_u_px"] for d in documents} == {None}
    assert encode_refused(None, PROVENANCE)["points"] is None


def test_markers_are_kept_with_points_or_without_calibration(calibration: Calibration) -> None:
    rng = np.random.default_rng(8)
    markers = {marker: rng.normal(300, 100, (4, 2)) for marker in (7, 0, 81)}
    points = dataclasses.replace(calibration.points, markers_px=markers)
    for row in (
        encode_refused(points, PROVENANCE),
        encode_calibration(dataclasses.replace(calibration, points=points), PROVENANCE),
    ):
        decoded = decode_markers(row["markers"])
        assert list(decoded) == [0, 7, 81]
        for marker, corners in markers.items():
            np.testing.assert_array_equal(decoded[marker], corners)
    assert (
        decode_markers(encode_refused(dataclasses.replace(points, markers_px={}), PROVENANCE)["markers"])
        == {}
    )
    # targets that have none are distinguished from those of which none was seen
    assert encode_calibration(calibration, PROVENANCE)["markers"] is None
    assert encode_refused(None, PROVENANCE)["markers"] is None


def test_origin_and_capture_quality_survive_with_a_calibration_or_without(calibration: Calibration) -> None:
    quality = CaptureQuality(
        edge_width_px=np.pi,
        motion_blur_px=0.1 + 0.2,
        motion_blur_direction=np.nextafter(1.0, 2.0),
        saturated_fraction=0.0,
        clipped_fraction=None,
        contrast=1e-300,
        coverage_fraction=1 / 3,
        tilt=np.pi / 7,
        advice=(Advisory("blurred", "d", "Focus."), Advisory("low_contrast", "e", None)),
    )
    for labelling in ("absolute", "up_to_symmetry"):
        points = dataclasses.replace(calibration.points, labelling=labelling, capture_quality=quality)
        row = encode_refused(points, PROVENANCE)
        stored = json.loads(json.dumps(row["capture_quality"], allow_nan=False))
        advice = tuple(Advisory(**one) for one in stored["advice"])
        assert (row["labelling"], CaptureQuality(**{**stored, "advice": advice})) == (labelling, quality)
        row = encode_calibration(dataclasses.replace(calibration, points=points), PROVENANCE)
        assert (row["labelling"], row["capture_quality"]) == (labelling, stored)
    nothing = encode_refused(None, PROVENANCE)
    assert nothing["labelling"] is nothing["capture_quality"] is None


def test_a_figure_without_meaning_is_no_figure(calibration: Calibration) -> None:
    quality = CaptureQuality(np.nan, np.inf, None, None, None, None, 0.5, None, ())
    points = dataclasses.replace(calibration.points, capture_quality=quality)
    stored = encode_refused(points, PROVENANCE)["capture_quality"]
    assert stored["edge_width_px"] is stored["motion_blur_px"] is None
    assert stored["coverage_fraction"] == 0.5
    assert {name for name, value in stored.items() if value is None} == {*stored} - {
        "coverage_fraction",
        "advice",
    }


def test_points_are_compact(calibration: Calibration) -> None:
    row = encode_calibration(calibration, PROVENANCE)
    assert len(row["points"]) == 31 * 45
