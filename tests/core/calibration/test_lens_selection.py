"""Selection of the lens model over a session: false alarms, power, and the pooled estimate with the model chosen."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.calibration import (
    GroupEstimate,
    estimate_group,
    number_labels,
    select_lens,
    stack_views,
)
from core.calibration.lens_selection.selection import folds
from core.calibration.lens_selection.starts import observed_radius_px
from core.geometry import Camera, LensModel, fold_radius_px, lens_model_of, so3_log
from tests.support.simulation.wide_lenses import WideSession, choose_lens, draw_session


def pose_errors(session: WideSession, found: GroupEstimate) -> np.ndarray:
    """Squared Mahalanobis distances of the poses, six degrees of freedom each."""
    distances = []
    for k, i in enumerate(found.images.tolist()):
        T = session.T_camera_target[i]
        R, p = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
        off = np.concatenate([p - found.positions_mm[k], so3_log(R @ found.rotations[k].T)])
        distances.append(float(off @ np.linalg.solve(found.covariance[k], off)))
    return np.array(distances)


@pytest.mark.parametrize("bow_mm", [0.0, 0.1])
def test_browns_model_stays_where_nothing_is_gained(bow_mm: float) -> None:
    """Noise alone, and a bowed board, which bends the residuals as a lens does."""
    rng = np.random.default_rng(1)
    for images in (3, 6, 10):
        choice, found = choose_lens(draw_session(rng, "brown", images=images, bow_mm=bow_mm).views)
        assert choice.model == lens_model_of(found.camera) == "brown"
        assert choice.start is None
        assert choice.evidence is not None
        assert not choice.evidence.beyond_brown


@pytest.mark.parametrize("model", ["kannala_brandt", "rational"])
def test_a_lens_beyond_browns_is_found_and_its_poses_hold(model: LensModel) -> None:
    session = draw_session(np.random.default_rng(4), model, images=10)
    choice, found = choose_lens(session.views)
    assert choice.model in ("kannala_brandt", "rational")
    assert choice.evidence is not None
    assert choice.evidence.beyond_brown
    assert choice.evidence.held_out is not None
    assert choice.evidence.held_out < 0.95
    assert lens_model_of(found.camera) == choice.model
    assert found.reduced_chi2 == pytest.approx(1.0, abs=0.25)
    size = len(found.camera.as_array())
    assert found.camera_covariance.shape == (size, size)
    # 60 degrees of freedom, most of them shared: five of their standard deviations at six times that correlation.
    assert float(np.mean(pose_errors(session, found))) < 30.0


def test_a_model_that_is_asked_for_is_taken() -> None:
    session = draw_session(np.random.default_rng(5), "brown", images=8)
    for asked in ("kannala_brandt", "rational"):
        choice, found = choose_lens(session.views, asked)
        assert choice.model == lens_model_of(found.camera) == asked
    choice, found = choose_lens(draw_session(np.random.default_rng(4), "kannala_brandt").views, "brown")
    assert choice.model == lens_model_of(found.camera) == "brown"
    assert choice.evidence is not None
    assert choice.evidence.beyond_brown


def test_a_lens_is_found_without_an_estimate_to_begin_with() -> None:
    session = draw_session(np.random.default_rng(6), "kannala_brandt", images=8)
    views = stack_views(session.views)
    choice = select_lens(views, number_labels(range(len(views))), None, None)
    assert choice.model == "kannala_brandt"
    assert choice.start is not None
    assert choice.evidence is None
    assert choice.start.fx_px == pytest.approx(session.camera.fx_px, rel=0.02)


@pytest.mark.parametrize(("ratio", "refused"), [(0.9, True), (1.03, True), (1.1, False)])
def test_a_model_that_turns_back_within_the_points_or_just_beyond_is_not_taken(
    ratio: float, refused: bool
) -> None:
    session = draw_session(np.random.default_rng(5), "brown", images=4)
    views = stack_views(session.views)
    plain = Camera(900.0, 900.0, 639.5, 479.5)
    farthest = ratio * observed_radius_px(views.points_px, plain)
    # f r (1 + k1 r²) is greatest at r = 1/√(-3 k1), where it is two thirds of f r.
    k1 = -1.0 / (3.0 * (1.5 * farthest / plain.fx_px) ** 2)
    camera = Camera(900.0, 900.0, 639.5, 479.5, k1)
    assert fold_radius_px(camera) == pytest.approx(farthest, rel=1e-6)
    assert folds(camera, views, np.ones(len(views.points_px), dtype=np.bool_)) is refused


def test_one_image_does_not_decide() -> None:
    session = draw_session(np.random.default_rng(7), "kannala_brandt", images=1)
    views = stack_views(session.views)
    choice = select_lens(views, np.zeros(1, dtype=np.intp), None, None)
    assert (choice.model, choice.start, choice.evidence) == ("brown", None, None)


@pytest.mark.parametrize("model", ["kannala_brandt", "rational"])
def test_a_focal_length_for_each_image_goes_with_the_lens(model: LensModel) -> None:
    session = draw_session(np.random.default_rng(8), model, images=10)
    choice, _ = choose_lens(session.views, model)
    found = estimate_group(stack_views(session.views), "pooled_free_focal", lens_start=choice.start)
    assert lens_model_of(found.camera) == model
    assert len(np.unique(found.cameras[:, 0])) == len(found.images)
    assert np.mean(found.cameras[:, 0]) == pytest.approx(session.camera.fx_px, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("bow_mm", [0.0, 0.1])
def test_false_alarms_are_rare(bow_mm: float) -> None:
    """None among 150 sessions: the rate is below 2 % with a confidence of 95 %."""
    rng = np.random.default_rng(11)
    counts = rng.integers(2, 13, 150)
    alarms = [
        choose_lens(draw_session(rng, "brown", images=int(count), bow_mm=bow_mm).views)[0].model != "brown"
        for count in counts
    ]
    assert sum(alarms) == 0


@pytest.mark.slow
@pytest.mark.parametrize("model", ["kannala_brandt", "rational"])
def test_intervals_with_the_model_chosen_cover(model: LensModel) -> None:
    """Of poses and f, with the true model drawn from the priors: 95 % of 28 sessions, within three standard errors."""
    rng = np.random.default_rng(12)
    focal, position = [], []
    for _ in range(28):
        session = draw_session(rng, model, images=10)
        _, found = choose_lens(session.views, model)
        u = math.sqrt(float(found.camera_covariance[0, 0]))
        focal.append(abs(found.camera.fx_px - session.camera.fx_px) < 1.96 * u)
        position.append(float(np.mean(pose_errors(session, found) < 12.592)))  # χ²₆ at 95 %
    assert np.mean(focal) > 0.826
    assert np.mean(position) > 0.826
