"""Joint noise of a real UR10, from pairs of visits before a laser tracker, predicts the scatter at poses held out.

Source and layout: test_ur10_identification. Of the 1,202 poses of series B 293 were visited twice.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.cluster.hierarchy import fcluster, linkage

from core.kinematics import PoseData, fit_joint_noise, gather_scatters
from core.session.joint_noise import predict_scatter, validate_joint_noise
from tests.support.simulation.robots.arms import UR10
from tests.support.simulation.robots.ur10_tracker import tracked

SAME_ANGLES = 1e-3
"""Of the stated angles, rad: those of two visits to a pose differ by .0002 at most."""
MAX_APART_MM = 0.1
"""Of two visits, whose median is .022 mm: beyond it, four pairs .4 to 2.3 mm apart, the pose was not the same."""


def visits(data_folder: Path) -> PoseData:
    """Return all visits by their poses.

    Poses of one visit say nothing of the scatter: they determine the tool, which the repeated ones hardly turn.
    """
    poses = tracked(data_folder)
    pose = fcluster(linkage(poses.joint_angles, "single"), SAME_ANGLES, "distance")
    return dataclasses.replace(poses, labels=tuple(f"P{k}" for k in pose))


@pytest.mark.slow
def test_joint_noise_of_a_ur10_predicts_held_out_poses(data_folder: Path) -> None:
    seen = gather_scatters(visits(data_folder), UR10)
    assert len(seen.labels) == 293
    assert set(seen.visits.tolist()) == {2}
    noise = fit_joint_noise(seen)
    # Of two visits that disagree neither counts: the four pairs that were not at one pose, and no other.
    apart = [np.linalg.norm(np.ptp(seen.deviations[seen.pose == k, :3], axis=0)) for k in range(293)]
    lost = seen.without(noise.outliers).visits == 0
    assert lost.sum() == 4
    np.testing.assert_array_equal(lost, np.array(apart) > MAX_APART_MM)
    held_out = validate_joint_noise(seen, noise)
    print(
        f"scatter ratio {held_out.chi_ratio:.3f}, log RP rms {held_out.rp_log_rms:.3f} (visits alone "
        f"{held_out.rp_log_expected:.3f}, one covariance {held_out.constant_rp_log_rms:.3f}), gain "
        f"{held_out.log_likelihood_gain:.0f}"
    )
    # 289 pairs are as many degrees of freedom of six components: the size is known to 1.7 %.
    assert abs(held_out.chi_ratio - 1.0) < 0.05
    assert held_out.log_likelihood_gain > 100.0
    # The spread of RP of two visits is almost all theirs: what the model adds to it is small.
    assert held_out.rp_log_rms < held_out.constant_rp_log_rms
    assert held_out.rp_log_rms < 1.06 * held_out.rp_log_expected
    # Hundredths of a millimetre everywhere; the maker promises .1 mm.
    rp = predict_scatter(noise, seen.arm, seen.joint_angles).rp_l_mm
    assert 0.02 < rp.min() < rp.max() < 0.1
