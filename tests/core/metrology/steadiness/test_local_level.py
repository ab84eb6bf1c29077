"""The slow motion of a witness: found where there is one, nothing where it rests."""

from __future__ import annotations

import numpy as np

from core.metrology import slow_motion

CYCLES = np.arange(1, 31)


def test_nothing_moves_at_rest() -> None:
    """False alarms: once in twenty on the edge; 60 sessions with more than 9 have a chance of 1e-3."""
    rng = np.random.default_rng(0)
    found = [slow_motion(CYCLES, rng.normal(0.0, 0.02, (30, 3))) for _ in range(60)]
    assert sum(bool(one.motion_mm.any()) for one in found) <= 9
    still = slow_motion(CYCLES, np.ones((30, 3)))
    assert not still.motion_mm.any()


def test_drift_and_slip_are_followed_within_their_uncertainty() -> None:
    rng = np.random.default_rng(1)
    drift = np.linspace(-0.05, 0.05, 30)[:, None] * [1.0, 0.5, 0.0]
    slip = np.where(CYCLES > 15, 0.05, -0.05)[:, None] * [0.0, 1.0, 0.0]
    for motion in (drift, slip):
        z = []
        for _ in range(20):
            found = slow_motion(CYCLES, motion + rng.normal(0.0, 0.02, (30, 3)))
            z.append((found.motion_mm - motion) / found.standard_uncertainty_mm[:, None])
            assert np.std(found.motion_mm - motion) < 0.6 * 0.02
        assert np.sqrt(np.mean(np.square(z))) < 1.5


def test_missing_cycles_do_not_move_it() -> None:
    rng = np.random.default_rng(2)
    kept = np.sort(rng.choice(CYCLES, 20, replace=False))
    motion = 0.004 * (kept - kept.mean())[:, None] * [1.0, 0.0, 0.0]
    found = slow_motion(kept, motion + rng.normal(0.0, 0.01, (20, 3)))
    assert np.abs(found.motion_mm - motion).max() < 0.02
