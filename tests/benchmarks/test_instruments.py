"""The figures of docs/instruments.md: that they are of what they say."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.goals import sections_of
from benchmarks.trust.instruments import (
    DISTANCES_MM,
    POSES,
    TILTS,
    _of_images,
    _of_session,
    _points,
    _Seen,
    _view,
    table_of,
)
from core.geometry import project, transform_points
from tests.support.simulation.scenes import standard_camera, standard_target


@pytest.fixture(scope="module")
def truth() -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    return [_view(600.0, rng) for _ in range(POSES)]


@pytest.mark.parametrize("distance_mm", DISTANCES_MM)
def test_every_view_is_of_the_stated_set_up(distance_mm: float) -> None:
    T = _view(distance_mm, np.random.default_rng(3))
    grid = standard_target(14, 10).points_target()
    middle = 0.5 * (grid.min(axis=0) + grid.max(axis=0))
    assert (T[:3, :3] @ middle + T[:3, 3])[2] == pytest.approx(distance_mm)
    assert TILTS[0] <= math.acos(T[2, 2]) <= TILTS[1]
    pixels = project(transform_points(T, grid), standard_camera())
    assert pixels.min() > 0
    assert np.all(pixels < [2448, 2050])


def test_errors_of_a_session_are_within_what_is_stated_and_below_those_of_single_images(
    truth: list[np.ndarray],
) -> None:
    rng = np.random.default_rng(6)
    views = [_points(T, 0.05, rng) for T in truth]
    session, alone = _Seen([], [], [], [], [], []), _Seen([], [], [], [], [], [])
    _of_session(views, truth, session)
    _of_images(views, truth, alone)
    assert len(session.position_mm) == len(session.scatter_mm) == POSES
    z = np.array(session.position_mm) / session.stated_position_mm
    assert 0.1 < np.sqrt(np.mean(z**2)) < 3.0  # errors that the shared camera makes are common to all ten
    assert np.mean(session.scatter_mm) < np.mean(session.stated_position_mm)
    assert np.mean(session.stated_position_mm) < np.mean(alone.stated_position_mm)
    assert np.mean(session.position_mm) < np.mean(alone.position_mm)
    assert np.max(np.array(session.rotation) / session.stated_rotation) < 5.0


def test_the_page_has_the_figures_of_the_run_that_is_kept() -> None:
    root = Path(__file__).parents[2]
    kept = sections_of((root / "benchmarks" / "RESULTS.md").read_text(encoding="utf-8"))["instruments"]
    assert table_of(kept.rows) in (root / "docs" / "instruments.md").read_text(encoding="utf-8")
