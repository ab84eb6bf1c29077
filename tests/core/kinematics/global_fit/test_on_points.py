"""Robot and lens from grid points together: truth recovered, uncertainty stated, the lens's error shared."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import InvalidArgument, JointAnglesInconsistent
from core.geometry.camera import CAMERA_PARAMETERS, Camera
from core.geometry.lens_models import KannalaBrandtCamera
from core.geometry.se3 import invert
from core.kinematics.identification import identify_from_images
from core.simulation.arm import KR5_ARC
from tests.support.simulation.robots.arm_grid_points import CAMERA, GRID, common_fit, session
from tests.support.simulation.robots.arms import identifiable_truth, stated


def camera_ratio(found: Camera, covariance: np.ndarray) -> np.ndarray:
    return (found.as_array() - CAMERA.as_array())[:8] / np.sqrt(np.diag(covariance)[:8])


def test_a_perfect_robot_is_identified_to_microns() -> None:
    arm, q, views, _ = session(1)
    found = identify_from_images(common_fit(views), q, KR5_ARC)
    off = found.robot.chain.as_array() - identifiable_truth(arm, q)
    ratio = off / stated(found.robot)
    assert np.nanmax(np.abs(ratio)) < 4.5
    assert 0.4 < np.sqrt(np.nanmean(ratio**2)) < 1.8  # one arm's errors are correlated
    lengths, turns = off[:, [0, 2]], off[:, [1, 3, 4]]
    assert np.sqrt(np.mean(lengths[lengths != 0.0] ** 2)) < 0.01
    assert np.degrees(np.sqrt(np.mean(turns[turns != 0.0] ** 2))) < 0.001
    assert np.max(np.abs(camera_ratio(found.camera, found.camera_covariance))) < 4.5
    assert found.rms_px == pytest.approx(0.02 * math.sqrt(2.0), rel=0.05)
    assert len(found.T_target_camera) == len(views)
    assert found.robot.scatter_position_mm < 0.003


def test_a_lens_beyond_brown_is_carried_through() -> None:
    """Before Kannala's and Brandt's lens, robot and lens are the true ones; Brown's model leaves more over."""
    camera = KannalaBrandtCamera(1500.0, 1498.0, 1230.0, 1018.0, 0.02, -0.03, 0.01, 0.0, 1e-4, -2e-4)
    arm, q, views, _ = session(2, camera=camera, sigma_px=0.01)
    found = identify_from_images(common_fit(views, camera), q, KR5_ARC, folds=0)
    assert isinstance(found.camera, KannalaBrandtCamera)
    truth = identifiable_truth(arm, q)
    ratio = (found.robot.chain.as_array() - truth) / stated(found.robot)
    assert np.nanmax(np.abs(ratio)) < 4.5
    of_lens = (found.camera.as_array() - camera.as_array()) / np.sqrt(np.diag(found.camera_covariance))
    assert np.max(np.abs(of_lens)) < 4.5
    assert found.rms_px == pytest.approx(0.01 * math.sqrt(2.0), rel=0.1)
    brown = identify_from_images(common_fit(views), q, KR5_ARC, folds=0)
    coordinates = 2 * sum(len(view.points_px) for view in views)
    assert (
        2.0 * coordinates * math.log(brown.rms_px / found.rms_px) > 30.0
    )  # -2 log of the likelihoods' ratio


@pytest.mark.slow
def test_a_print_that_is_not_flat_is_in_the_uncertainty() -> None:
    """Five arms before a grid bowed by .1 mm, five times the noise. If the lens's covariance lacked it, a third of the
    stated intervals would miss."""
    ratios = []
    for seed in range(20, 25):
        arm, q, views, _ = session(seed, bow_mm=0.1)
        found = identify_from_images(common_fit(views), q, KR5_ARC, folds=0)
        ratios.append((found.robot.chain.as_array() - identifiable_truth(arm, q)) / stated(found.robot))
    ratio = np.array(ratios)
    ratio = ratio[np.isfinite(ratio)]
    # Of 5 arms with 24 parameters each, which are correlated within an arm: 95 % give or take 4 %.
    assert np.mean(np.abs(ratio) < 1.96) > 0.87


@pytest.mark.slow
def test_one_bow_pulls_the_lens_of_all_images_equally() -> None:
    """A robot that scatters determines the lens little: the bow must be in the lens's own uncertainty."""
    ratios, of_cameras = [], []
    for seed in range(20, 26):
        arm, q, views, _ = session(seed, bow_mm=0.1, position_mm=0.03, rotation_rad=math.radians(0.005))
        found = identify_from_images(common_fit(views), q, KR5_ARC, folds=0)
        ratios.append((found.robot.chain.as_array() - identifiable_truth(arm, q)) / stated(found.robot))
        of_cameras.append(camera_ratio(found.camera, found.camera_covariance))
    ratio = np.array(ratios)
    # One bow makes all cameras' errors, in eight numbers: their rms is 1 but for a factor of two; taken for independent
    # from image to image it is 3.5.
    assert np.sqrt(np.mean(np.square(of_cameras))) < 2.0
    # Of six arms with 18 parameters each, correlated within an arm (.07): 95 % give or take 10 %.
    assert np.mean(np.abs(ratio[np.isfinite(ratio)]) < 1.96) > 0.85


def test_exact_points_of_a_perfect_robot_leave_nothing() -> None:
    arm, q, views, _ = session(2, count=24, sigma_px=0.0)
    found = identify_from_images(common_fit(views), q, KR5_ARC, folds=0)
    np.testing.assert_allclose(found.T_target_camera, arm.camera_poses(q), atol=2e-5)
    assert found.rms_px < 1e-5
    assert found.camera.fx_px == pytest.approx(CAMERA.fx_px, abs=1e-3)


def test_a_robot_that_scatters_is_identified_within_its_stated_uncertainty() -> None:
    arm, q, views, _ = session(3, count=48, position_mm=0.03, rotation_rad=math.radians(0.005))
    found = identify_from_images(common_fit(views), q, KR5_ARC)
    ratio = (found.robot.chain.as_array() - identifiable_truth(arm, q)) / stated(found.robot)
    assert np.nanmax(np.abs(ratio)) < 4.5
    assert found.robot.scatter_position_mm == pytest.approx(0.03, rel=0.3)
    assert found.robot.scatter_rotation == pytest.approx(math.radians(0.005), rel=0.3)
    assert found.robot.validation is not None
    assert found.robot.validation.identified.position_rms_mm < 0.1
    # The images say where the camera was, to microns; the chain does not pull it away.
    assert np.sqrt(np.mean((found.T_target_camera - arm.camera_poses(q))[:, :3, 3] ** 2)) > 0.02
    assert found.rms_px == pytest.approx(0.02 * math.sqrt(2.0), rel=0.05)


def test_two_targets_in_one_session() -> None:
    arm, q, views, target = session(4, targets=2)
    found = identify_from_images(common_fit(views), q, KR5_ARC, target=target, folds=0)
    (tie,) = found.robot.target_transforms
    true = arm.T_target_base[0] @ invert(arm.T_target_base[1])
    assert np.all(np.abs(true[:3, 3] - tie.T_from_to[:3, 3]) < 4.5 * np.sqrt(np.diag(tie.covariance)[:3]))
    assert (
        np.nanmax(np.abs((found.robot.chain.as_array() - identifiable_truth(arm, q)) / stated(found.robot)))
        < 4.5
    )


def test_the_prints_scale_is_in_the_uncertainty_of_every_length() -> None:
    _, q, views, _ = session(5, count=24)
    uncertain = replace(GRID, pitch_standard_uncertainty_mm=0.025)  # a thousandth
    plain = identify_from_images(common_fit(views), q, KR5_ARC, folds=0)
    found = identify_from_images(
        common_fit([replace(v, target=uncertain) for v in views]), q, KR5_ARC, folds=0
    )
    upper_arm = found.robot.joints[1]
    assert upper_arm.standard_uncertainty["a_mm"] == pytest.approx(0.6, rel=0.05)
    turned = plain.robot.joints[2].standard_uncertainty["alpha_rad"]
    assert found.robot.joints[2].standard_uncertainty["alpha_rad"] == pytest.approx(turned, rel=0.05)


def test_an_image_with_other_joint_angles_is_excluded() -> None:
    _, q, views, _ = session(6, position_mm=0.03, rotation_rad=math.radians(0.005))
    q = q.copy()
    q[7, 3] += math.radians(1.0)
    found = identify_from_images(
        common_fit(views), q, KR5_ARC, labels=tuple(f"P{i}" for i in range(len(views))), folds=0
    )
    assert np.flatnonzero(~found.robot.used).tolist() == [7]
    assert any("P7" in w.detail for w in found.robot.warnings)


def test_covariance_of_the_lens_names_what_it_is_of() -> None:
    _, q, views, _ = session(7, count=24)
    found = identify_from_images(common_fit(views), q, KR5_ARC, folds=0)
    assert found.camera_covariance.shape == (len(CAMERA_PARAMETERS),) * 2
    assert np.all(np.linalg.eigvalsh(found.camera_covariance[:8, :8]) > 0.0)
    assert not found.camera_covariance[8].any()  # k3 is held


def test_images_and_angles_come_in_pairs() -> None:
    _, q, views, _ = session(8, count=8)
    with pytest.raises(InvalidArgument, match=r"8 .* 7"):
        identify_from_images(common_fit(views), q[1:], KR5_ARC)
    with pytest.raises(InvalidArgument):
        common_fit([])


def test_angles_of_other_images_are_found_out() -> None:
    _, q, views, _ = session(9, count=24)
    with pytest.raises(JointAnglesInconsistent):
        identify_from_images(common_fit(views), np.roll(q, 5, axis=0), KR5_ARC)
