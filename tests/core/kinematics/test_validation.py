"""Which poses are held out together: all visits to one configuration, whatever the encoders' last digits are."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.cluster.hierarchy import fclusterdata

from core.kinematics.global_fit.blocks import Blocking
from core.kinematics.global_fit.joint_configurations import SAME_CONFIGURATION, configurations
from core.kinematics.global_fit.validation import assign_folds
from core.kinematics.identification import ModelChoice, identify
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, free_angles, kr5_arc, sweep_angles
from tests.support.simulation.simulated_poses import Repeatability, measure_poses

VISITS = 30


@pytest.mark.parametrize("jitter_deg", [0.0, 0.005, 0.01, 0.02])
def test_visits_at_encoder_readings_share_a_fold(jitter_deg: float) -> None:
    rng = np.random.default_rng(31)
    commanded = free_angles(rng, KR5_ARC_HOME, 40)
    names = np.repeat([f"P{i}" for i in range(40)], VISITS)
    q = np.repeat(commanded, VISITS, axis=0)
    q = q + math.radians(jitter_deg) * rng.normal(0.0, 1.0, q.shape)
    folds = assign_folds(q, 5, names.tolist()).reshape(40, VISITS)
    assert np.all(folds == folds[:, :1])
    assert np.bincount(folds[:, 0]).tolist() == [8] * 5
    # Readings alone show it where they differ by less than the tolerance.
    if jitter_deg <= 0.01:
        assert np.array_equal(assign_folds(q, 5).reshape(40, VISITS), folds)


def test_linkage_is_by_chains_of_readings_and_by_names() -> None:
    step = 0.9 * SAME_CONFIGURATION
    q = np.zeros((6, 2))
    q[:, 1] = [0.0, step, 2.0 * step, 10.0 * step, 20.0 * step, 20.0 * step + 1.2 * SAME_CONFIGURATION]
    assert configurations(q).tolist() == [0, 0, 0, 1, 2, 3]
    assert configurations(q, ["a", "b", "c", "d", "e", "f"]).tolist() == [0, 0, 0, 1, 2, 3]
    assert configurations(q, ["a", "b", "c", "d", "e", "e"]).tolist() == [0, 0, 0, 1, 2, 2]
    assert configurations(q, ["a", "b", "c", "d", "a", "e"]).tolist() == [0, 0, 0, 1, 0, 2]
    assert configurations(q, tolerance=0.8 * step).tolist() == [0, 1, 2, 3, 4, 5]
    # In another order the same poses are together, and have the same numbers.
    order = np.array([4, 2, 0, 5, 3, 1])
    assert configurations(q[order]).tolist() == np.array([0, 0, 0, 1, 2, 3])[order].tolist()


@pytest.mark.parametrize("spread", [0.02, 0.5, 1.0, 3.0])
def test_clusters_are_those_of_single_linkage(spread: float) -> None:
    """Repeats on both sides of a cell's border, chains through several cells, and joints in any number."""
    rng = np.random.default_rng(34)
    for joints in (1, 2, 6):
        centres = rng.uniform(-3.0, 3.0, (9, joints))
        q = centres[rng.integers(0, 9, 200)] + spread * SAME_CONFIGURATION * rng.normal(size=(200, joints))
        linked = fclusterdata(q, SAME_CONFIGURATION, "distance", metric="chebyshev", method="single")
        found = configurations(q)
        pairs = set(zip(linked.tolist(), found.tolist(), strict=True))
        assert len(pairs) == len(set(linked.tolist())) == len(set(found.tolist()))


def test_time_grows_with_the_number_of_poses_not_with_its_square() -> None:
    """Free poses make many clusters, repeats many pairs: the square of 40,000 takes most of a minute in both."""
    rng = np.random.default_rng(35)
    free = rng.uniform(-3.0, 3.0, (40_000, 6))
    repeats = free[rng.integers(0, 5, 40_000)] + 1e-5 * rng.normal(size=(40_000, 6))
    started = time.process_time()
    assert len(np.unique(configurations(free))) == 40_000
    assert len(np.unique(configurations(repeats))) == 5
    assert time.process_time() - started < 10.0  # .3 s on a machine with nothing else to do


def test_repeats_at_jittering_readings_say_no_more_than_at_steady_ones() -> None:
    """A gear's error that no chain has is the same at all visits: dealt apart, these would foretell one another."""
    rng = np.random.default_rng(32)
    arm = kr5_arc(rng)
    q = np.repeat(free_angles(rng, KR5_ARC_HOME, 14), 10, axis=0)
    readings = q + math.radians(0.02) * rng.normal(0.0, 1.0, q.shape)

    def held_out(at: np.ndarray) -> float:
        turned = at + math.radians(0.02) * np.sin(2.0 * at + np.arange(6))
        poses = measure_poses(
            arm, turned, np.random.default_rng(33), estimator="given", robot=Repeatability(0.01, 1e-5)
        )
        names = tuple(f"P{i // 10}" for i in range(len(q)))
        found = identify(replace(poses, joint_angles=at, labels=names), KR5_ARC)
        assert found.validation is not None
        return found.validation.identified.position_rms_mm

    # Configuration by configuration the folds are the same ones; 140 predictions in 14 groups.
    assert held_out(readings) == pytest.approx(held_out(q), rel=0.2)


@pytest.mark.parametrize("steps", [15, 20, 30])
def test_long_sweeps_alone_are_identified_and_held_out_by_blocks_that_leave_an_arm(steps: int) -> None:
    """The elbow has one angle at five sweeps of six: without these poses nothing is determined."""
    rng = np.random.default_rng(34)
    q = sweep_angles(KR5_ARC_HOME, half_arc=math.radians(35.0), steps=steps)
    poses = measure_poses(kr5_arc(rng), q, rng, estimator="given", robot=Repeatability(0.02, 1e-5))
    found = identify(poses, KR5_ARC, model=ModelChoice.AUTO)
    assert found.validation is not None
    assert Blocking.ELBOW not in {block.blocking for block in found.validation.blocks}
    assert {Blocking.ORDER, Blocking.CLUSTERS} <= {block.blocking for block in found.validation.blocks}
