"""The sentence about a session's images."""

from __future__ import annotations

from typing import Any

import pytest

from app.client import describe_measured, is_measured
from app.client.summary import outcome_in_words

CAMERA = {"intrinsics": {"fx_px": 1000.0}, "standard_uncertainty": {"fx_px": 4.0}}


def measurement(
    grade: str | None = None, code: str | None = None, pose_id: str = "P1", sha256: str = "0"
) -> dict[str, Any]:
    return {
        "pose_id": pose_id,
        "sha256": sha256,
        "status": "succeeded" if code is None else "failed",
        "calibration": None if grade is None else {"grade": grade},
        "failure": None if code is None else {"code": code},
    }


WEAK, DETERMINED = measurement("weak"), measurement("determined")
FLAT, LOST = measurement(code="focal_not_observable"), measurement(code="target_not_found")


def images(*measurements: dict[str, Any]) -> list[dict[str, Any]]:
    return [{**each, "sha256": str(place)} for place, each in enumerate(measurements)]


def test_an_image_of_two_targets_counts_once() -> None:
    both = [*images(DETERMINED, WEAK), *images(DETERMINED, FLAT)]
    assert describe_measured(both, [CAMERA]).startswith("2 photographs measured; 1 determines the camera")


def test_images_whose_points_serve_are_measured() -> None:
    assert [is_measured(m) for m in (WEAK, DETERMINED, FLAT, LOST)] == [True, True, True, False]


@pytest.mark.parametrize(
    ("measurements", "cameras", "numbers"),
    [
        (
            images(*[WEAK] * 5, *[FLAT] * 3),
            [CAMERA],
            "8 photographs measured; 0 determine the camera by themselves, ",
        ),
        (
            images(DETERMINED, WEAK, LOST),
            [CAMERA],
            "2 photographs measured; 1 determines the camera by itself, ",
        ),
    ],
)
def test_the_session_camera_is_named_with_its_uncertainty(
    measurements: list[dict[str, Any]], cameras: list[dict[str, Any]], numbers: str
) -> None:
    assert describe_measured(measurements, cameras) == numbers + "the session's camera does (± 0.4 %)"


def test_the_least_certain_of_several_cameras_counts() -> None:
    other = {"intrinsics": {"fx_px": 1000.0}, "standard_uncertainty": {"fx_px": 10.0}}
    assert describe_measured(images(WEAK, WEAK), [CAMERA, other]).endswith(
        "the session's 2 cameras do (± 1 %)"
    )


@pytest.mark.parametrize("one", [DETERMINED, WEAK, FLAT])
def test_one_image_is_not_said_to_be_pooled(one: dict[str, Any]) -> None:
    assert describe_measured([one], [CAMERA]) == "1 photograph measured: focal length ± 0.4 %"


def test_no_camera_is_claimed_where_none_was_calibrated() -> None:
    assert "±" not in describe_measured([FLAT], None)
    said = describe_measured(images(*[FLAT] * 5), None)
    assert said == "5 photographs measured, which do not determine the camera yet, not even together"
    assert describe_measured([LOST], None).startswith("0 photographs measured")


def test_an_image_whose_points_serve_is_not_said_to_have_failed() -> None:
    before = measurement(code="target_already_measured")
    assert [outcome_in_words(m) for m in (WEAK, FLAT, LOST, before, {**LOST, "status": "queued"})] == [
        *("measured", "measured, no pose by itself", "not measured", "measured before", "queued")
    ]
