"""The door for several targets: each that is in view once, and none for another."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core import GridposeError, TargetSpec, calibrate_image, calibrate_targets
from core.errors import TargetAmbiguous, TargetMismatch, TargetNotFound, UndecodableImage
from tests.support.simulation.renders import render
from tests.support.simulation.room_corner import Corner, png

CHESSBOARD = TargetSpec("chessboard", 8, 5, 18.0)
OTHER_CHESSBOARD = TargetSpec("chessboard", 7, 4, 20.0)
CHARUCO = TargetSpec("charuco", 6, 5, 22.0, marker_mm=16.0, dictionary="DICT_5X5_100")
SAME_DICTIONARY = dataclasses.replace(CHARUCO, columns=7)


@pytest.fixture(scope="module")
def image() -> bytes:
    corner = Corner(CHESSBOARD, CHARUCO)
    return corner.image(corner.view(turn=0.3))


def test_each_target_has_the_calibration_it_has_by_itself(image: bytes) -> None:
    absent = TargetSpec("circles", 7, 5, 20.0)
    targets = (OTHER_CHESSBOARD, CHARUCO, absent, CHESSBOARD)
    outcomes = list(calibrate_targets(image, targets))
    assert [outcome.target for outcome in outcomes] == list(targets)
    assert [outcome.calibration is not None for outcome in outcomes] == [False, True, False, True]
    assert isinstance(outcomes[0].failure, TargetMismatch)
    assert isinstance(outcomes[2].failure, TargetNotFound)
    for outcome in (outcomes[1], outcomes[3]):
        assert outcome.calibration is not None
        alone = calibrate_image(image, outcome.target)
        np.testing.assert_array_equal(outcome.calibration.T_camera_target, alone.T_camera_target)
        np.testing.assert_array_equal(outcome.calibration.covariance, alone.covariance)
        assert outcome.calibration.points == alone.points
        assert outcome.calibration.warnings == alone.warnings
        assert outcome.calibration.points.capture_quality is not None


def test_boards_that_look_the_same_are_reported_as_such(image: bytes) -> None:
    finer = dataclasses.replace(CHESSBOARD, pitch_mm=9.0)
    upright = dataclasses.replace(CHESSBOARD, columns=5, rows=8)
    outcomes = list(calibrate_targets(image, (CHESSBOARD, CHARUCO, finer, upright)))
    for outcome in (outcomes[0], outcomes[2], outcomes[3]):
        assert isinstance(outcome.failure, TargetAmbiguous)
        assert outcome.failure.points is None
        assert "18 mm" in outcome.failure.detail
        assert "9 mm" in outcome.failure.detail
        assert "5 x 8" in outcome.failure.detail
        assert "target_id" in (outcome.failure.advice or "")
    shown = outcomes[1].calibration
    assert shown is not None
    assert [w.code for w in shown.warnings].count("target_ambiguous") == 1


def test_a_board_wholly_in_view_is_not_a_part_of_a_larger_one(image: bytes) -> None:
    """The larger one's dictionary is the same, and part of it would be enough."""
    for targets in ((CHARUCO, SAME_DICTIONARY), (SAME_DICTIONARY, CHARUCO)):
        outcomes = {outcome.target: outcome for outcome in calibrate_targets(image, targets)}
        assert outcomes[CHARUCO].calibration is not None
        failure = outcomes[SAME_DICTIONARY].failure
        assert isinstance(failure, GridposeError)
        assert failure.points is None


def test_a_refused_view_keeps_its_points() -> None:
    T = np.eye(4)
    T[:3, 3] = -70.0, -40.0, 420.0
    flat, _ = Corner(CHESSBOARD, CHARUCO).scenes(T)
    (outcome,) = calibrate_targets(png(render(flat)), (CHESSBOARD,))
    assert outcome.calibration is None
    assert outcome.failure is not None
    assert outcome.failure.code == "focal_not_observable"
    assert len(outcome.failure.points) == CHESSBOARD.size
    assert outcome.failure.points.capture_quality is not None


def test_what_is_no_image_is_no_outcome_of_a_target(image: bytes) -> None:
    with pytest.raises(UndecodableImage):
        calibrate_targets(image[: len(image) // 2], (CHESSBOARD, CHARUCO))
    assert list(calibrate_targets(image, ())) == []
