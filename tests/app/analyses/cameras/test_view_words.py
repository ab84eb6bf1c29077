"""Words for a view say which edge of the target goes away, and where the target is to appear."""

from __future__ import annotations

import math

import numpy as np
import pytest

from app.analyses.documents.view_words import instruction
from core.calibration import CommonFit, estimate_group
from core.geometry import project, so3_exp, transform, transform_points
from tests.support.sessions.stored_sessions import BOARD, CAMERA, draw_board_pose, look

MIDDLE = BOARD.points_target().mean(axis=0)


@pytest.fixture(scope="module")
def fit() -> CommonFit:
    rng = np.random.default_rng(3)
    views = [look(rng, draw_board_pose(rng, 30.0)) for _ in range(5)]
    found = estimate_group(views, "pooled").fit
    assert found is not None
    return found


def words(fit: CommonFit, turns: tuple[float, float], centre: tuple[float, float, float]) -> str:
    R = so3_exp(np.radians([*turns, 0.0])) @ _upright(fit)
    T = transform(R, np.array(centre) - R @ MIDDLE)
    pixel = project(transform_points(T, MIDDLE[None]), CAMERA)[0]
    return instruction(T, pixel, float(np.linalg.norm(centre)), fit)


def _upright(fit: CommonFit) -> np.ndarray:
    R = fit.placements.rotations
    angle = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    mean = math.atan2(float(np.sin(angle).mean()), float(np.cos(angle).mean()))
    return so3_exp(np.array([0.0, 0.0, mean]))


@pytest.mark.parametrize(
    ("turns", "edge", "farther"),
    [
        ((30.0, 0.0), "tilt 30° about x (lower edge away)", (0.0, 1.0)),
        ((-30.0, 0.0), "tilt 30° about x (upper edge away)", (0.0, -1.0)),
        ((0.0, 30.0), "tilt 30° about y (left edge away)", (-1.0, 0.0)),
        ((0.0, -30.0), "tilt 30° about y (right edge away)", (1.0, 0.0)),
        ((20.0, 20.0), "tilt 28° (lower left corner away)", (-1.0, 1.0)),
        ((0.0, 0.0), "face the target squarely", None),
    ],
)
def test_the_edge_named_is_the_farther_one(
    fit: CommonFit, turns: tuple[float, float], edge: str, farther: tuple[float, float] | None
) -> None:
    assert words(fit, turns, (0.0, 0.0, 400.0)).startswith(edge)
    if farther is None:
        return
    R = so3_exp(np.radians([*turns, 0.0])) @ _upright(fit)
    points = (BOARD.points_target() - MIDDLE) @ R.T
    along = points[:, :2] @ np.array(farther)
    assert points[np.argmax(along), 2] > 0.0  # depth grows towards the edge that is named


def test_where_the_target_appears_and_how_far_away(fit: CommonFit) -> None:
    assert "target in the middle" in words(fit, (0.0, 0.0), (0.0, 0.0, 400.0))
    assert "target at the left" in words(fit, (0.0, 0.0), (-120.0, 0.0, 400.0))
    assert "target at the bottom" in words(fit, (0.0, 0.0), (0.0, 110.0, 400.0))
    assert "target at the lower right" in words(fit, (0.0, 0.0), (120.0, 110.0, 400.0))
    assert words(fit, (0.0, 0.0), (0.0, 0.0, 4000.0)).endswith("4000 mm away (farther)")
    assert words(fit, (0.0, 0.0), (0.0, 0.0, 20.0)).endswith("20 mm away (nearer)")
    assert "turn the image" not in words(fit, (0.0, 0.0), (0.0, 0.0, 400.0))
