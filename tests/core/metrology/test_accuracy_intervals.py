"""Intervals of AP where the scatter of the mean pose is as large as the deviation, or differs from pose to pose."""

from __future__ import annotations

import numpy as np
import pytest

from core.metrology.accuracy import MeanNoise, TiedDeviations, estimate_deviations
from core.session.commanded_poses.mean_noise import moderated_variances


def deviations(
    e: np.ndarray, u: np.ndarray, rng: np.random.Generator, *, out: int | None = None
) -> TiedDeviations:
    """Return deviations read with noise of mean poses, in frames that are one shift, that of all poses but `out`."""
    seen = e + rng.normal(0.0, 1.0, e.shape) * u[:, None]
    used = np.ones(len(e), dtype=np.bool_)
    if out is not None:
        used[out] = False
    leverage = np.broadcast_to(np.eye(3) / np.sum(used), (len(e), 3, 3))
    noise = MeanNoise(u**2, np.full(len(e), np.inf))
    return TiedDeviations(seen - seen[used].mean(axis=0), leverage, np.zeros((len(e), 3, 0)), used, noise)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.2, 1.0, 5.0])
def test_they_hold_whatever_the_scatter_is_to_the_deviation(ratio: float) -> None:
    rng = np.random.default_rng(3)
    inside, trials, poses = 0, 60, 8
    for _ in range(trials):
        e = rng.normal(0.0, 1.0, (poses, 3))
        u = ratio * np.where(np.arange(poses) == 0, 3.0, 1.0)
        for found, length in zip(
            estimate_deviations(deviations(e, u, rng)), np.linalg.norm(e, axis=1), strict=True
        ):
            assert found.length_interval is not None
            inside += found.length_interval[0] <= length <= found.length_interval[1]
    # Three standard errors; a residual below its noise has a longer interval than it needs.
    assert inside / (trials * poses) > 0.95 - 3.0 * np.sqrt(0.05 * 0.95 / (trials * poses))


def test_noise_alone_is_no_deviation() -> None:
    rng = np.random.default_rng(1)
    e, u = np.zeros((6, 3)), np.full(6, 0.1)
    for found in estimate_deviations(deviations(e, u, rng)):
        assert found.length_interval is not None
        assert found.length_interval[0] < 0.05
        assert found.length_interval[1] > 0.1


def test_a_pose_that_tied_no_frames_is_off_by_what_is_read() -> None:
    rng = np.random.default_rng(2)
    e, u = np.zeros((6, 3)), np.full(6, 1e-3)
    e[4, 1] = 5.0
    found = estimate_deviations(deviations(e, u, rng, out=4))[4]
    assert found.vector is not None
    assert np.linalg.norm(found.vector) == pytest.approx(5.0, abs=0.01)
    assert found.length_interval == found.held_out_interval
    assert found.length_interval is not None
    assert found.length_interval[0] < 5.0 < found.length_interval[1] < 5.02


def test_poses_of_one_scatter_share_it() -> None:
    rng = np.random.default_rng(5)
    freedom = np.array([27.0, 27.0, 27.0, 3.0, 0.0])
    variance, found = moderated_variances(rng.chisquare(np.maximum(freedom, 1e-9)), freedom)
    assert variance == pytest.approx(np.full(5, variance[0]), rel=0.3)
    assert found.min() > 10.0
    restless, of_each = moderated_variances(np.array([27.0, 27.0, 27.0, 27.0 * 25.0]), np.full(4, 27.0))
    assert restless[3] == pytest.approx(25.0, rel=0.1)
    assert restless[0] == pytest.approx(1.0, rel=0.1)
    assert of_each.max() < 40.0
