"""Joint noise of a real FANUC R-2000iC predicts the scatter at poses held out, better than one ellipsoid for all."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from core.kinematics import fit_joint_noise, gather_scatters
from core.session.joint_noise import predict_scatter, validate_joint_noise
from tests.support.simulation.robots.fanuc_tracker import FANUC, fanuc_visits


def test_joint_noise_of_a_fanuc_predicts_held_out_poses(data_folder: Path) -> None:
    seen = gather_scatters(fanuc_visits(data_folder), FANUC)
    assert len(seen.labels) == 24
    assert set(seen.visits.tolist()) == {10}
    noise = fit_joint_noise(seen)
    held_out = validate_joint_noise(seen, noise)
    print(
        f"scatter ratio {held_out.chi_ratio:.3f}, log RP rms {held_out.rp_log_rms:.2f} (visits alone "
        f"{held_out.rp_log_expected:.2f}, one covariance {held_out.constant_rp_log_rms:.2f}), gain "
        f"{held_out.log_likelihood_gain:.0f}"
    )
    # 216 degrees of freedom of six components: the size is known to 2 %, the model is of this robot to some more.
    assert abs(held_out.chi_ratio - 1.0) < 0.1
    assert held_out.log_likelihood_gain > 100.0
    assert held_out.rp_log_rms < 0.8 * held_out.constant_rp_log_rms
    # The first joint turns the longest lever, and is the noisiest of the three large ones.
    sigma = np.degrees(noise.deviations[:3])
    assert 0.0015 < sigma[0] < 0.0030
    assert np.all(sigma[1:] < 0.5 * sigma[0])
    # Tenths of a millimetre at the poses measured, and twice as much where the arm is stretched.
    rp = predict_scatter(noise, seen.arm, seen.joint_angles).rp_l_mm
    assert 0.1 < rp.min() < 0.6 * rp.max() < 0.3
