"""Corrected commands: simulated arms get where the controller means, and the UR10 does at poses that had no part."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.kinematics import (
    ErrorModel,
    Identification,
    Level,
    ModelChoice,
    Outcome,
    correct,
    correction_model,
    curves_ratio,
    forward,
    identify,
    solve_inverse,
)
from core.kinematics.correction import MAX_CONFIRMING_RATIO, CorrectionModel
from core.simulation.arm import KR5_ARC, KR5_ARC_LIMITS
from tests.support.simulation.robots.real_arms import Gears, RealArm, angles_within_limits, measured, real_arm


def rms(errors: np.ndarray) -> float:
    return math.sqrt(float(np.mean(np.sum(errors**2, axis=-1))))


def corrections(found: Identification, *, curves: bool) -> CorrectionModel:
    assert found.error_model is not None
    assert found.nominal_arm is not None
    return correction_model(found.error_model, found.nominal_arm, found.validation, curves=curves)


@pytest.fixture(scope="module")
def built() -> tuple[RealArm, CorrectionModel, CorrectionModel]:
    """An arm with gears and compliance, corrected without curves and with them."""
    rng = np.random.default_rng(7)
    real = real_arm(rng)
    poses = measured(real, angles_within_limits(rng, 120), rng)
    found = identify(poses, KR5_ARC, model=ModelChoice.AUTO)
    return real, corrections(found, curves=False), corrections(found, curves=True)


def errors_at(real: RealArm, by: CorrectionModel, q: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Return the rms distance from where the controller means to be, uncorrected and corrected, and what was stated."""
    meant = by.meant(q)[:, :3, 3]
    found = correct(by, q)
    assert {o for o in found.outcomes if not o.applied} <= {Outcome.OUTSIDE_REGION}
    q, meant, angles = q[found.applied], meant[found.applied], found.joint_angles[found.applied]
    before = real.arm.camera_poses(real.turned(q))[:, :3, 3] - meant
    after = real.arm.camera_poses(real.turned(angles))[:, :3, 3] - meant
    return rms(before), rms(after), found.expected[0, found.applied]


def test_corrected_commands_go_where_they_are_meant(
    built: tuple[RealArm, CorrectionModel, CorrectionModel],
) -> None:
    real, plain, curved = built
    q = angles_within_limits(np.random.default_rng(8), 200, share=0.5)
    before, after, expected = errors_at(real, plain, q)
    assert plain.level in (Level.DH, Level.COMPLIANCE)
    assert after < 0.5 * before
    # What is stated includes the noise of one more measurement, as held-out poses have it.
    assert after < 1.1 * rms(expected[:, None])
    assert plain.random.position_ratio == pytest.approx(after / before, rel=0.35)
    _, with_curves, expected = errors_at(real, curved, q)
    assert curved.level is Level.ALL
    assert with_curves < 0.7 * after
    assert with_curves < 1.2 * rms(expected[:, None])


def test_what_the_controller_is_given_is_its_own_model_of_the_corrected_angles(
    built: tuple[RealArm, CorrectionModel, CorrectionModel],
) -> None:
    _, plain, _ = built
    q = angles_within_limits(np.random.default_rng(9), 20, share=0.5)
    found = correct(plain, q)
    assert found.T_base_flange == pytest.approx(forward(KR5_ARC, found.joint_angles))
    # At the corrected angles the identified arm is where the nominal one was meant to be.
    regular = np.flatnonzero([outcome is Outcome.CORRECTED for outcome in found.outcomes])
    assert len(regular) >= 17
    left = plain.attained(found.joint_angles) - plain.meant(q)
    assert np.max(np.linalg.norm(left[regular, :3, 3], axis=1)) < 0.01
    assert found.shift[0] == pytest.approx(
        np.linalg.norm(plain.attained(q)[:, :3, 3] - plain.meant(q)[:, :3, 3], axis=1)
    )


def test_commands_outside_the_region_or_beyond_limits_are_left_as_they_are(
    built: tuple[RealArm, CorrectionModel, CorrectionModel],
) -> None:
    _, plain, _ = built
    inside = angles_within_limits(np.random.default_rng(10), 1, share=0.3)
    inside[0, 4] = 0.8
    outside = inside.copy()
    outside[0, 4] = plain.region[4].maximum + 0.01
    found = correct(plain, np.concatenate([inside, outside]))
    assert found.outcomes == (Outcome.CORRECTED, Outcome.OUTSIDE_REGION)
    assert found.joint_angles[1] == pytest.approx(outside[0])
    assert np.isnan(found.expected[:, 1]).all()
    assert np.isfinite(found.expected[:, 0]).all()
    tight = np.stack([inside[0] - 1e-9, inside[0] + 1e-9])
    assert correct(plain, inside, tight).outcomes == (Outcome.BEYOND_LIMITS,)
    assert correct(plain, inside, KR5_ARC_LIMITS.T).outcomes == (Outcome.CORRECTED,)
    # Limits of coupled joints are those of the angles that the controller takes.
    coupling = np.eye(6)
    coupling[2, 1] = 1.0
    commanded = np.linalg.solve(coupling, inside[0])
    room = np.stack([commanded - 0.1, commanded + 0.1])
    assert correct(plain, inside, room, coupling).outcomes == (Outcome.CORRECTED,)
    assert correct(plain, inside, room).outcomes == (Outcome.BEYOND_LIMITS,)


def test_a_singular_wrist_is_not_thrown_about(
    built: tuple[RealArm, CorrectionModel, CorrectionModel],
) -> None:
    _, plain, _ = built
    q = angles_within_limits(np.random.default_rng(11), 1, share=0.3)
    q[0, 4] = 1e-7
    found = correct(plain, q)
    assert np.max(np.abs(found.joint_angles - q)) < math.radians(0.3)
    # The position is met all the same; what is left of the rotation is stated.
    left = plain.attained(found.joint_angles) - plain.meant(q)
    assert np.linalg.norm(left[0, :3, 3]) < 0.02
    assert found.outcomes == (Outcome.NEAR_SINGULARITY,)
    assert found.expected[1, 0] > plain.deviations(q)[1, 0]


def test_no_correction_ends_farther_off_than_the_command_as_it_was(
    built: tuple[RealArm, CorrectionModel, CorrectionModel],
) -> None:
    _, plain, _ = built
    rng = np.random.default_rng(13)
    q = angles_within_limits(rng, 200, share=0.3)
    q[:, 4] = np.radians(rng.uniform(-6.0, 6.0, 200))
    found = correct(plain, q)
    meant, before, after = (
        T[:, :3, 3] for T in (plain.meant(q), plain.attained(q), plain.attained(found.joint_angles))
    )
    left, shift = np.linalg.norm(after - meant, axis=1), np.linalg.norm(before - meant, axis=1)
    assert np.all(left <= np.maximum(shift, 0.01) + 1e-9)
    assert found.applied.mean() > 0.5


def again(real: RealArm, rng: np.random.Generator) -> ErrorModel:
    """Measure the arm in a second session."""
    q = angles_within_limits(rng, 50)
    model = identify(measured(real, q, rng), KR5_ARC, folds=0, model=ModelChoice.AUTO).error_model
    assert model is not None
    return model


def test_curves_are_confirmed_by_a_second_session_of_the_same_gears_alone(
    built: tuple[RealArm, CorrectionModel, CorrectionModel],
) -> None:
    real, _, curved = built
    rng = np.random.default_rng(12)
    same = again(real, rng)
    ratio = curves_ratio(curved, same)
    assert ratio is not None
    assert ratio < 0.8 < MAX_CONFIRMING_RATIO
    other_gears = RealArm(real.arm, Gears.drawn(rng, 6), real.links)
    changed = again(other_gears, rng)
    other = curves_ratio(curved, changed)
    assert other is not None
    assert other > MAX_CONFIRMING_RATIO


def test_the_inverse_of_a_chain_is_found_from_known_configurations() -> None:
    rng = np.random.default_rng(13)
    known, asked = angles_within_limits(rng, 80), angles_within_limits(rng, 40, share=0.5)
    T = forward(KR5_ARC, asked)
    found = solve_inverse(KR5_ARC, T, known)
    assert found.attained.mean() > 0.9
    assert forward(KR5_ARC, found.joint_angles[found.attained]) == pytest.approx(T[found.attained], abs=1e-5)
    far = T[:1].copy()
    far[0, :3, 3] *= 50.0
    assert not solve_inverse(KR5_ARC, far, known).attained[0]


def test_the_inverse_within_what_was_measured_is_taken() -> None:
    """Measured with the wrist bent one way, as robots work: poses there are not reached by another way of the arm."""
    rng = np.random.default_rng(14)
    low, high = np.radians(
        [(-150.0, -140.0, -5.0, -170.0, 10.0, -170.0), (150.0, 50.0, 140.0, 170.0, 110.0, 170.0)]
    )
    known, asked = (low + (high - low) * rng.uniform(0.1, 0.9, (count, 6)) for count in (100, 200))
    found = solve_inverse(KR5_ARC, forward(KR5_ARC, asked), known)
    assert found.attained.all()
    inside = np.all((found.joint_angles >= low) & (found.joint_angles <= high), axis=1)
    assert inside.mean() > 0.95
    assert np.mean(np.max(np.abs(found.joint_angles - asked), axis=1) < 1e-4) > 0.9
