"""What is predicted before a session is what the session's identification states; suggestions help most."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import TooFewPoses
from core.geometry.se3 import invert
from core.kinematics.dh import forward
from core.kinematics.identification import identify
from core.kinematics.planning import (
    CameraSetup,
    choose_informative,
    count_visible_points,
    default_setup,
    predict,
    suggest_poses,
)
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, T_FLANGE_CAMERA, Arm, free_angles
from tests.support.simulation.robots.arm_grid_points import CAMERA, GRID, SIZE, image_poses, session
from tests.support.simulation.robots.arms import stated


def rig_of(arm: Arm, **how: float) -> CameraSetup:
    return CameraSetup(CAMERA, *SIZE, 0.02, GRID, arm.T_flange_camera, arm.T_target_base[0], **how)


@pytest.mark.parametrize("scatter", [0.0, 1.0], ids=["perfect robot", "robot that scatters"])
def test_predicted_uncertainties_are_those_stated_afterwards(scatter: float) -> None:
    position, rotation = scatter * 0.03, scatter * math.radians(0.005)
    arm, q, views, _ = session(11, count=40, position_mm=position, rotation_rad=rotation)
    found = identify(image_poses(views, q), KR5_ARC, folds=0)
    # Planned with the nominal chain, as one has to.
    planned = predict(
        KR5_ARC, q, replace(rig_of(arm), scatter_position_mm=position, scatter_rotation=rotation)
    )
    assert planned.visible.all()
    assert planned.names == found.names
    assert planned.null_space == found.null_space
    ratio = stated(found) / np.array(
        [[value or math.nan for value in joint.standard_uncertainty.values()] for joint in planned.joints]
    )
    assert np.array_equal(np.isfinite(ratio), np.isfinite(stated(found)))
    # The scatter is estimated from 40 poses to some 10 %; a perfect robot's by chance not quite to nothing.
    assert float(np.nanmin(ratio)) > 0.75
    assert float(np.nanmax(ratio)) < 1.5
    assert planned.conditioning.condition_number == pytest.approx(
        found.conditioning.condition_number, rel=0.1
    )


def test_poses_that_do_not_see_the_grid_count_for_nothing() -> None:
    arm, q, _, _ = session(12, count=20)
    away = q[:6].copy()
    away[:, 0] += math.radians(120.0)
    planned = predict(KR5_ARC, np.concatenate([q, away]), rig_of(arm))
    assert planned.visible.tolist() == [True] * 20 + [False] * 6
    with pytest.raises(TooFewPoses, match="0 of 6"):
        predict(KR5_ARC, away, rig_of(arm))


def test_a_grid_seen_from_behind_is_not_visible() -> None:
    rig = default_setup(KR5_ARC, KR5_ARC_HOME, CAMERA, SIZE, GRID, T_FLANGE_CAMERA, noise_px=0.05)
    assert count_visible_points(KR5_ARC, KR5_ARC_HOME[None], rig).tolist() == [True]
    turned = replace(rig, T_target_base=np.diag([1.0, -1.0, -1.0, 1.0]) @ rig.T_target_base)
    assert count_visible_points(KR5_ARC, KR5_ARC_HOME[None], turned).tolist() == [False]


def test_the_rig_puts_the_grid_before_the_camera() -> None:
    rig = default_setup(KR5_ARC, KR5_ARC_HOME, CAMERA, SIZE, GRID, T_FLANGE_CAMERA, noise_px=0.05, fill=0.5)
    T = invert(rig.T_target_base @ forward(KR5_ARC, KR5_ARC_HOME[None])[0] @ rig.T_flange_camera)
    middle = T[:3, :3] @ GRID.points_target().mean(axis=0) + T[:3, 3]
    assert middle[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert CAMERA.fx_px * 14 * 25.0 / middle[2] <= 0.5 * SIZE[0] + 1e-6


def test_suggested_poses_help_more_than_others() -> None:
    rig = default_setup(KR5_ARC, KR5_ARC_HOME, CAMERA, SIZE, GRID, T_FLANGE_CAMERA, noise_px=0.05, fill=0.3)
    rng = np.random.default_rng(5)
    candidates = free_angles(rng, KR5_ARC_HOME, 600, half_range=math.radians(12.0))
    candidates[:, 5] += rng.uniform(-2.0, 2.0, len(candidates))
    seen = np.flatnonzero(count_visible_points(KR5_ARC, candidates, rig))
    assert 60 < len(seen) < 600
    begun, pool = candidates[seen[:12]], candidates[seen[12:]]
    chosen = suggest_poses(KR5_ARC, begun, pool, rig, 12)
    assert len(set(chosen.tolist())) == 12
    best = predict(KR5_ARC, np.concatenate([begun, pool[chosen]]), rig)
    others = [
        predict(KR5_ARC, np.concatenate([begun, pool[rng.choice(len(pool), 12, replace=False)]]), rig)
        for _ in range(4)
    ]
    assert best.conditioning.observability_o1 > 1.05 * max(o.conditioning.observability_o1 for o in others)
    assert np.all(np.isfinite(best.covariance))


def test_suggestions_are_only_of_poses_that_see_the_grid() -> None:
    arm, q, _, _ = session(12, count=20)
    away = q[:6].copy()
    away[:, 0] += math.radians(120.0)
    chosen = suggest_poses(KR5_ARC, q[:12], np.concatenate([away, q[12:15]]), rig_of(arm), 8)
    assert sorted(chosen.tolist()) == [6, 7, 8]


def greedy(M: np.ndarray, pool: np.ndarray, count: int) -> list[int]:
    chosen: list[int] = []
    for _ in range(count):
        left = [i for i in range(len(pool)) if i not in chosen]
        chosen.append(max(left, key=lambda i: value(M, pool, [*chosen, i])))
    return chosen


def value(M: np.ndarray, pool: np.ndarray, chosen: object) -> float:
    return float(np.linalg.slogdet(M + sum(pool[i].T @ pool[i] for i in chosen))[1])  # type: ignore[attr-defined]


def test_exchange_improves_on_the_greedy_choice_and_mostly_finds_the_best() -> None:
    rng = np.random.default_rng(8)
    better = found_best = 0
    for _ in range(20):
        pool = rng.normal(size=(9, 2, 6)) * rng.uniform(0.3, 2.0, (9, 1, 6))
        M = 1e-6 * np.eye(6)
        chosen = choose_informative(M, pool, 4).tolist()
        assert len(set(chosen)) == 4
        reached, begun = value(M, pool, chosen), value(M, pool, greedy(M, pool, 4))
        best = max(value(M, pool, some) for some in itertools.combinations(range(9), 4))
        assert begun - 1e-6 <= reached <= best + 1e-6
        better += reached > begun + 1e-3
        found_best += reached > best - 1e-6
    assert better >= 3
    assert found_best >= 14
    assert sorted(choose_informative(M, pool, 30).tolist()) == list(range(9))
