"""Certificates: the grid they give, at the temperature of the session, and what they leave open."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from core.calibration import ShapePrior
from core.errors import InvalidTarget
from core.targets import Certificate, CertificateUncertainty, TargetSpec, detect, target_of
from tests.support.simulation.renders import render
from tests.support.simulation.scenes import standard_scene

BOARD = TargetSpec("chessboard", 5, 4, 10.0)
PITCHES = Certificate(
    temperature_c=20.0,
    expansion_per_k=1e-5,
    pitch_x_mm=10.01,
    pitch_y_mm=9.99,
    squareness_mrad=1.0,
    standard_uncertainty=CertificateUncertainty(0.003, 0.004, 0.2),
)


def test_pitches_and_squareness_place_the_points() -> None:
    certified = dataclasses.replace(BOARD, certificate=PITCHES)
    points = certified.points_target()
    np.testing.assert_allclose(points[-1], [4 * 10.01 + 1e-3 * 3 * 9.99, 3 * 9.99, 0.0])
    column, row = np.array([4, 0]), np.array([3, 1])
    np.testing.assert_array_equal(certified.points_target(column, row), points[[19, 5]])
    assert certified.scale_standard_uncertainty == pytest.approx(0.5 * 5e-3 / 10.0)
    prior = ShapePrior.of(certified)
    assert prior.shape.aspect == pytest.approx(5e-4)
    assert prior.shape.shear == pytest.approx(2e-4)
    assert prior.certified


def test_lengths_are_taken_to_the_temperature_of_the_session() -> None:
    fields = json.loads(json.dumps(dataclasses.asdict(dataclasses.replace(BOARD, certificate=PITCHES))))
    cold, warm = (target_of({**fields, "temperature_c": t}).points_target() for t in (None, 30.0))
    np.testing.assert_allclose(warm, cold * 1.0001)


def test_points_row_by_row_replace_the_grid() -> None:
    places = BOARD.points_target() + np.random.default_rng(1).normal(0.0, 0.05, (20, 3))
    stated = Certificate.of({"points_mm": places.tolist(), "points_standard_uncertainty_mm": 0.002})
    certified = dataclasses.replace(BOARD, certificate=stated)
    np.testing.assert_array_equal(certified.points_target(), places)
    assert hash(certified) == hash(dataclasses.replace(BOARD, certificate=stated))
    assert ShapePrior.of(certified).shape.point_mm == 0.002


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({}, "neither"),
        ({"pitch_x_mm": 10.0}, "neither"),
        ({"pitch_x_mm": 10.0, "pitch_y_mm": 10.0}, "standard_uncertainty"),
        ({"points_mm": [[0.0, 0.0, 0.0]]}, "points_standard_uncertainty_mm"),
        ({"points_mm": [[0.0, 0.0, 0.0]], "points_standard_uncertainty_mm": 0.01}, "the target 20"),
        (
            {
                "temperature_c": 20.0,
                "pitch_x_mm": 10.0,
                "pitch_y_mm": 10.0,
                "standard_uncertainty": {"pitch_x_mm": 0.0, "pitch_y_mm": 0.0},
            },
            "expansion_per_k",
        ),
        (
            {
                "pitch_x_mm": 25.4,
                "pitch_y_mm": 25.4,
                "standard_uncertainty": {"pitch_x_mm": 0.0, "pitch_y_mm": 0.0},
            },
            "tenth of a pitch",
        ),
    ],
)
def test_certificates_that_contradict_are_refused(fields: dict[str, object], says: str) -> None:
    with pytest.raises(InvalidTarget, match=says):
        dataclasses.replace(BOARD, certificate=Certificate.of(fields))


@pytest.mark.parametrize(
    "target",
    [
        TargetSpec("circles", 9, 7, 25.0),
        TargetSpec("asymmetric_circles", 4, 11, 20.0),
        TargetSpec("aprilgrid", 5, 4, 35.0, 25.0),
        TargetSpec("charuco", 9, 6, 25.0, 18.0, "DICT_5X5_100"),
    ],
    ids=lambda target: target.kind,
)
def test_a_board_with_certified_points_is_found_as_one_without(target: TargetSpec) -> None:
    """Points of a row are never exactly in line; whether points are those of a plane is asked by rows."""
    image = render(standard_scene(target, seed=1))
    points = target.points_target() + np.random.default_rng(1).normal(0.0, 0.005, (target.size, 3))
    certificate = Certificate(
        points_mm=tuple(map(tuple, points.tolist())), points_standard_uncertainty_mm=0.002
    )
    plain, certified = (
        detect(image, t) for t in (target, dataclasses.replace(target, certificate=certificate))
    )
    assert len(plain) > 0.9 * target.size
    np.testing.assert_array_equal(certified.column, plain.column)
    np.testing.assert_allclose(certified.points_px, plain.points_px, atol=0.02)
