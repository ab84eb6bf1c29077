"""Cycles that do not count because their image is degraded, and those that count all the same."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.metrology import PoseRepeatability
from core.session import PoseRow, SessionData, assess_repeatability, estimate_session
from core.session.repeatability.degraded_images import degraded_images
from tests.support.simulation.correlated_noise import (
    DISTURBANCES,
    NoisySession,
    gaussian_field,
    noisy_session,
    session_data,
    white,
)


def degraded_at(image: int, sigma_px: float, robot_mm: float = 0.005) -> NoisySession:
    """Return a session whose one image has a smooth pattern in addition to the noise of the others."""
    session = noisy_session(np.random.default_rng(21), white(), robot_mm=robot_mm)
    views = session.views
    part = views.part(image)
    rng = np.random.default_rng(22)
    pattern = gaussian_field(3.0, sigma_px)(rng, views.points_px[part], 90.0, 1)[0]
    points = views.points_px.copy()
    points[part] += pattern
    return dataclasses.replace(session, views=dataclasses.replace(views, points_px=points))


def rows_of(data: SessionData) -> dict[str, PoseRow]:
    return {row.pose_id: row for row in assess_repeatability(data, estimate_session(data)).poses}


def figures_of(row: PoseRow) -> PoseRepeatability:
    assert row.figures is not None
    return row.figures


def test_a_degraded_image_does_not_count_and_is_printed_with() -> None:
    data = session_data(degraded_at(37, 0.03))
    found = assess_repeatability(data, estimate_session(data))
    rows = {row.pose_id: row for row in found.poses}
    (excluded,) = rows["P1"].excluded
    assert (excluded.measurement_id, excluded.code) == ("m37", "image_degraded")
    assert "residuals of this image" in excluded.detail
    figures = figures_of(rows["P1"])
    assert (figures.n, len(rows["P1"].visits)) == (29, 29)
    assert rows["P1"].including_degraded is not None
    assert rows["P1"].including_degraded.position_mm > figures.repeatability.position_mm
    assert all(row.including_degraded is None for pose_id, row in rows.items() if pose_id != "P1")
    (warning,) = [w for w in found.warnings if w.code == "images_degraded"]
    assert "m37" in warning.detail


def test_noise_that_does_not_matter_next_to_the_robot_excludes_nothing() -> None:
    data = session_data(degraded_at(37, 0.03, robot_mm=0.5))
    estimate = estimate_session(data)
    assert "m37" in degraded_images(estimate)
    assert not any(row.excluded for row in assess_repeatability(data, estimate).poses)


@pytest.mark.parametrize("slip_mm", [0.1, 0.4])
def test_a_slip_on_a_sound_image_counts(slip_mm: float) -> None:
    """Farther than any noise: the residuals of the image are those of the others."""
    session = noisy_session(np.random.default_rng(21), white(), robot_mm=0.005)
    estimate = estimate_session(session_data(session))
    slipped = noisy_session(np.random.default_rng(21), white(), robot_mm=0.005, slip=(37, slip_mm))
    data = session_data(slipped)
    row = rows_of(data)["P1"]
    assert row.excluded == ()
    assert figures_of(row).n == 30
    assert figures_of(row).repeatability.position_mm > 0.3 * slip_mm
    assert degraded_images(estimate) == {} == degraded_images(estimate_session(data))


def test_a_slip_in_a_degraded_image_counts_where_its_noise_does_not_explain_it() -> None:
    degraded = degraded_at(37, 0.03)
    session = noisy_session(np.random.default_rng(21), white(), robot_mm=0.005)
    slipped = noisy_session(np.random.default_rng(21), white(), robot_mm=0.005, slip=(37, 2.0))
    points = degraded.views.points_px + slipped.views.points_px - session.views.points_px
    data = session_data(
        dataclasses.replace(degraded, views=dataclasses.replace(degraded.views, points_px=points))
    )
    assert "m37" in degraded_images(estimate_session(data))
    assert rows_of(data)["P1"].excluded == ()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["white", "field of 1 square", "field of 5 squares", "steady wave of .5 H"])
def test_clean_images_are_not_named(name: str) -> None:
    """Of 900 images none; the chance of one in a session of white noise is one in 2,000."""
    for seed in range(6):
        session = noisy_session(np.random.default_rng([seed, 4]), DISTURBANCES[name], robot_mm=0.02)
        assert degraded_images(estimate_session(session_data(session))) == {}


@pytest.mark.parametrize("cycles", [10, 30])
def test_sound_images_are_as_unlikely_as_stated(cycles: int) -> None:
    """Of the images below 1 % there are one in a hundred, and four standard deviations more at most."""
    found = []
    for seed in range(4):
        session = noisy_session(np.random.default_rng(100 + seed), white(), cycles=cycles)
        for group in estimate_session(session_data(session)).groups:
            found.append(group.estimate.image_p_values)
    p = np.concatenate(found)
    assert np.all(np.mean(p < 0.01, axis=0) <= 0.01 + 4.0 * np.sqrt(0.01 / len(p)))
