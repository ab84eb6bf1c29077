"""The error map says where a simulated arm is off its data sheet, and how well that is known."""

from __future__ import annotations

import numpy as np
import pytest

from core.errors import InvalidArgument
from core.kinematics import (
    ErrorModel,
    KinematicErrorMap,
    ModelChoice,
    identify,
    kinematic_error,
    map_kinematic_error,
)
from core.kinematics.arm_model import ArmState
from core.kinematics.correction.model import poses_of
from core.simulation.arm import KR5_ARC, KR5_ARC_LIMITS
from tests.support.simulation.robots.real_arms import RealArm, angles_within_limits, measured, real_arm

LIMITS = np.asarray(KR5_ARC_LIMITS).T
POSES = 80


@pytest.fixture(scope="module")
def built() -> tuple[RealArm, ErrorModel, ArmState]:
    rng = np.random.default_rng(17)
    real = real_arm(rng)
    found = identify(measured(real, angles_within_limits(rng, POSES), rng), KR5_ARC, model=ModelChoice.AUTO)
    assert found.error_model is not None
    assert found.nominal_arm is not None
    return real, found.error_model, found.nominal_arm


@pytest.fixture(scope="module")
def mapped(built: tuple[RealArm, ErrorModel, ArmState]) -> KinematicErrorMap:
    _, model, nominal = built
    return map_kinematic_error(model, nominal, LIMITS, samples=1500)


def test_the_error_is_the_true_one_within_its_uncertainty(
    built: tuple[RealArm, ErrorModel, ArmState],
) -> None:
    real, model, nominal = built
    q = angles_within_limits(np.random.default_rng(18), 300, share=0.55)
    found = kinematic_error(model, nominal, q)
    true = (real.arm.camera_poses(real.turned(q)) - poses_of(nominal, q))[:, :3, 3]
    np.testing.assert_allclose(np.linalg.norm(found.difference_mm, axis=1), found.length_mm)
    lengths = np.linalg.norm(true, axis=1)
    assert np.median(lengths) > 0.3  # mm; there is something to find
    off = found.length_mm - lengths
    assert np.sqrt(np.mean(off**2)) < 0.35 * np.sqrt(np.mean(lengths**2))
    assert 0.5 < np.sqrt(np.mean((off / found.standard_uncertainty_mm) ** 2)) < 1.5


def test_cells_hold_the_true_error_of_what_reaches_them(
    built: tuple[RealArm, ErrorModel, ArmState], mapped: KinematicErrorMap
) -> None:
    real, model, nominal = built
    q = angles_within_limits(np.random.default_rng(19), 6000)
    at = real.arm.camera_poses(real.turned(q))[:, :3, 3]
    true = np.linalg.norm(at - poses_of(nominal, q)[:, :3, 3], axis=1)
    in_base = (real.arm.camera_poses(q) - model.fit.design.arm.T_target_base[0])[:, :3, 3]
    place = np.linalg.inv(model.fit.design.arm.T_target_base[0])[:3, :3] @ in_base.T
    radius, height = np.hypot(place[0], place[1]), place[2]
    compared = []
    for cell in mapped.cells:
        half = 0.5 * mapped.cell_mm
        there = (np.abs(radius - cell.radius_mm) < half) & (np.abs(height - cell.height_mm) < half)
        if not cell.extrapolated and min(int(there.sum()), cell.configurations) >= 20:
            compared.append((cell.median_mm, float(np.median(true[there]))))
    found, expected = np.array(compared).T
    assert len(found) > 20
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.25 * np.sqrt(np.mean(expected**2))
    assert np.ptp(expected) > 0.3 * np.median(expected)  # places differ, and the map says where
    assert np.corrcoef(found, expected)[0, 1] > 0.5


def test_place_and_error_of_the_worst_place_are_in_the_base_frame(
    built: tuple[RealArm, ErrorModel, ArmState], mapped: KinematicErrorMap
) -> None:
    _, model, nominal = built
    q = mapped.worst_joint_angles[None]
    T_base_target = np.linalg.inv(model.fit.design.arm.T_target_base[0])
    ends = [poses_of(nominal, q)[0, :3, 3] + d for d in (mapped.worst.difference_mm[0], np.zeros(3))]
    attained, meant = (T_base_target[:3, :3] @ p + T_base_target[:3, 3] for p in ends)
    np.testing.assert_allclose(mapped.worst_difference_mm, attained - meant, atol=1e-9)
    assert np.linalg.norm(mapped.worst_position_mm - attained) < 5.0  # curves and compliance apart


def test_what_was_visited_is_marked_and_the_rest_is_extrapolated(
    built: tuple[RealArm, ErrorModel, ArmState], mapped: KinematicErrorMap
) -> None:
    _, model, nominal = built
    assert mapped.measured == int(model.fit.used.sum()) > 0.9 * POSES
    assert sum(cell.measured for cell in mapped.cells) == mapped.measured
    inside = [cell for cell in mapped.cells if not cell.extrapolated]
    outside = [cell for cell in mapped.cells if cell.extrapolated]
    assert inside
    assert outside
    assert not any(cell.measured for cell in outside)
    assert np.median([c.median_uncertainty_mm for c in outside]) > np.median(
        [c.median_uncertainty_mm for c in inside]
    )
    for cell in mapped.cells:
        assert cell.median_mm <= cell.largest_mm
    worst = float(mapped.worst.length_mm[0])
    assert worst >= max(cell.largest_mm for cell in inside)
    seen = model.fit.design.seen.joint_angles[model.fit.used]
    assert np.all(
        (mapped.worst_joint_angles >= seen.min(axis=0)) & (mapped.worst_joint_angles <= seen.max(axis=0))
    )
    assert mapped.median_mm < worst
    # Without limits beyond them, everything is where the poses were.
    alone = map_kinematic_error(model, nominal, np.stack([seen.min(axis=0), seen.max(axis=0)]), samples=500)
    assert not any(cell.extrapolated for cell in alone.cells)


def test_a_perfect_robot_is_off_by_what_is_not_known() -> None:
    rng = np.random.default_rng(23)
    real = real_arm(rng, perfect=True)
    found = identify(
        measured(real, angles_within_limits(rng, 60), rng), real.arm.chain, model=ModelChoice.AUTO
    )
    assert found.error_model is not None
    assert found.nominal_arm is not None
    mapped = map_kinematic_error(found.error_model, found.nominal_arm, LIMITS, samples=500)
    assert mapped.median_mm < 3.0 * mapped.median_uncertainty_mm
    assert mapped.median_mm < 0.1


def test_limits_the_wrong_way_round_are_refused(built: tuple[RealArm, ErrorModel, ArmState]) -> None:
    _, model, nominal = built
    with pytest.raises(InvalidArgument):
        map_kinematic_error(model, nominal, LIMITS[::-1])
