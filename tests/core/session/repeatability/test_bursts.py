"""Bursts: images of one stop are one cycle, and their scatter is a noise floor without a model."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.session import (
    MeasuredPose,
    SessionData,
    SessionRepeatability,
    assess_repeatability,
    estimate_session,
)
from core.session.model import CameraViews
from core.session.visits import merge_bursts, stop_mean
from tests.support.simulation.correlated_noise import noisy_session, session_data, white

ROBOT_MM = 0.02
SHAKE_RAD = 2e-4


def assessed(data: SessionData) -> SessionRepeatability:
    return assess_repeatability(data, estimate_session(data, "given"))


@pytest.fixture(scope="module")
def bursts() -> SessionData:
    """Two poses, twelve stops of three images each, of a robot that scatters."""
    session = noisy_session(np.random.default_rng(5), white(), poses=2, cycles=12, burst=3, robot_mm=ROBOT_MM)
    return session_data(session, session.camera)


@pytest.fixture(scope="module")
def found(bursts: SessionData) -> SessionRepeatability:
    return assessed(bursts)


def test_images_of_a_stop_are_one_cycle(bursts: SessionData, found: SessionRepeatability) -> None:
    for row in found.poses:
        assert row.figures is not None
        assert row.figures.n == 12
        assert [visit.cycle for visit in row.visits] == list(range(1, 13))
        assert all(len(visit.burst) == 3 for visit in row.visits)
    assert found.steadiness.longest == 12
    for way in found.performance.distances:
        assert way.found.performance.cycles == 12  # a cycle's images are one end of its distance
    apart = dataclasses.replace(
        bursts, images=tuple(dataclasses.replace(image, burst=None) for image in bursts.images)
    )
    alone = assessed(apart)
    assert [row.figures.n for row in alone.poses if row.figures is not None] == [36, 36]
    assert alone.bursts is None


def test_a_stop_is_the_mean_of_its_images(bursts: SessionData, found: SessionRepeatability) -> None:
    visit = found.poses[0].visits[4]
    images = visit.burst
    np.testing.assert_allclose(visit.position_mm, np.mean([one.position_mm for one in images], axis=0))
    scatters = [one.scatter for one in images if one.scatter is not None]
    assert visit.scatter is not None
    np.testing.assert_allclose(visit.scatter, np.sum(scatters, axis=0) / 9.0)
    assert visit.covariance is not None
    assert visit.common is not None
    np.testing.assert_allclose(
        visit.own_covariance(), np.sum([one.own_covariance() for one in images], axis=0) / 9
    )
    assert stop_mean(images[:1]) is images[0]


def test_the_scatter_within_stops_is_the_floor_of_the_model(found: SessionRepeatability) -> None:
    """24 degrees of freedom a pose, three axes: the floors agree within three standard deviations, 30 %."""
    assert found.bursts is not None
    assert (found.bursts.stops, found.bursts.images) == (24, 72)
    assert found.bursts.above_model == (False, False)
    assert all(abs(ratio - 1.0) < 0.25 for ratio in found.bursts.ratios)
    for row in found.poses:
        of_pose = found.bursts.poses[row.pose_id]
        assert (of_pose.stops, of_pose.images, of_pose.degrees_of_freedom) == (12, 36, 24)
        assert of_pose.noise_floor is not None
        assert row.figures is not None
        measured, modelled = of_pose.noise_floor.position_mm, row.figures.noise_floor.position_mm
        assert measured == pytest.approx(modelled, rel=0.35)
        reading = row.figures.repeatability.position_mm
        assert reading is not None
        assert measured is not None
        assert reading > 3.0 * measured  # the robot's own scatter is in no burst


def test_shaking_that_leaves_no_residual_raises_the_floor() -> None:
    """A camera that turns on its mount: no model of the points' noise sees it, the images of a stop do."""
    rng = np.random.default_rng(6)
    session = noisy_session(rng, white(), poses=2, cycles=12, burst=2, shake_rad=SHAKE_RAD)
    data = session_data(session, session.camera)
    found = assessed(data)
    assert found.bursts is not None
    assert found.bursts.above_model == (False, True)  # the camera's place does not move
    assert found.bursts.ratios[1] > 2.0
    (warning,) = [w for w in found.warnings if w.code == "burst_scatter_above_model"]
    assert "24 stops" in warning.detail
    assert warning.advice
    for row in found.poses:
        assert row.figures is not None
        turns = dict(row.figures.verdicts.items())
        assert all(turns[name] != "robot" for name in ("roll", "pitch", "yaw"))
        floor, reading = row.figures.noise_floor.yaw, row.figures.repeatability.yaw
        assert floor is not None
        assert reading is not None
        assert 0.6 < floor / reading < 1.7
    alone = dataclasses.replace(data, images=tuple(dataclasses.replace(i, burst=None) for i in data.images))
    for row in assessed(alone).poses:
        assert row.figures is not None
        floor, reading = row.figures.noise_floor.yaw, row.figures.repeatability.yaw
        assert floor is not None
        assert reading is not None
        assert floor < 0.6 * reading  # what the bursts mend


def test_an_image_without_an_index_or_cycle_is_a_stop_of_its_own(found: SessionRepeatability) -> None:
    images = list(found.poses[0].visits[0].burst)
    unnumbered = [dataclasses.replace(one, cycle=None) for one in images]
    assert len(merge_bursts(unnumbered)) == 3
    assert len(merge_bursts(images)) == 1
    of_two_boards = [images[0], dataclasses.replace(images[1], frame=1)]
    assert len(merge_bursts(of_two_boards)) == 2


def test_an_image_without_an_index_is_the_first_of_its_stop(found: SessionRepeatability) -> None:
    def indexed(*indices: int | None) -> list[MeasuredPose]:
        images = found.poses[0].visits[0].burst
        return [
            dataclasses.replace(one, image=dataclasses.replace(one.image, burst=index))
            for one, index in zip(images, indices, strict=True)
            if one.image is not None
        ]

    assert len(merge_bursts(indexed(None, 2, 3))) == 1
    assert len(merge_bursts(indexed(None, None, None))) == len(merge_bursts(indexed(1, 1, 1))) == 3


def test_images_of_different_focus_groups_at_one_stop_are_not_averaged(bursts: SessionData) -> None:
    """Their cameras' errors are apart: a stop of which one image is missing would be displaced, and none was named."""
    images = tuple(dataclasses.replace(one, focus_group=f"camera {one.burst}") for one in bursts.images)
    views = []
    for k in (1, 2, 3):
        chosen = np.array([i for i, one in enumerate(images) if one.burst == k])
        views.append(CameraViews(f"camera {k}", chosen, bursts.views[0].views.take(chosen)))
    found = assessed(dataclasses.replace(bursts, images=images, views=tuple(views)))
    assert "focus_groups_mixed" in {one.code for one in found.warnings}
    for row in found.poses:
        assert row.figures is not None
        assert row.figures.n == 36
        assert row.figures.verdict != "robot"
    assert found.bursts is None
