"""Suggested views of a robot: what they promise is what the session states with them, and they are few."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.errors import InvalidArgument, NoViewShowsTarget, TooFewMeasurements
from core.geometry import invert, project, transform_points
from core.kinematics import Chain, forward
from core.session import (
    NextRobotViews,
    SessionData,
    SessionEstimate,
    calibrate_session_hand_eye,
    estimate_session,
)
from core.session.model import CameraMount
from core.session.next_view.candidates import MAX_TILT
from core.session.next_view.reach import JOINT_MARGIN, RobotReach, robot_candidates
from core.session.next_view.views_expected import expected_views
from core.simulation import T_FLANGE_CAMERA
from tests.support.sessions.arm_views import ArmViews, arm_before_board, viewing_angles
from tests.support.sessions.planned_sessions import (
    DH,
    HAND_EYE,
    RobotPlan,
    chain_uncertainties,
    images_needed,
    least_mount_images,
)
from tests.support.sessions.stored_sessions import BOARD, CAMERA, HEIGHT, WIDTH

BEGUN = {HAND_EYE: 8, DH: 16}


@dataclasses.dataclass(frozen=True)
class Begun:
    """A session that has begun, and the four views that are suggested next."""

    plan: RobotPlan
    views: ArmViews
    data: SessionData
    estimate: SessionEstimate
    found: NextRobotViews

    def suggest(self, count: int, target: int = 0, data: SessionData | None = None) -> NextRobotViews:
        return self.plan.suggest(data or self.data, self.estimate, self.estimate.groups[0], target, count)


@pytest.fixture(scope="module", params=[HAND_EYE, DH], ids=["hand_eye", "dh"])
def begun(request: pytest.FixtureRequest) -> Begun:
    """A session of either purpose."""
    rng = np.random.default_rng(4)
    plan = request.param
    views = ArmViews(arm_before_board(rng, as_built=plan.as_built), rng, *plan.deviations)
    views.take(viewing_angles(views.arm, rng, BEGUN[plan]))
    data = views.all()
    estimate = estimate_session(data, "pooled")
    return Begun(plan, views, data, estimate, plan.suggest(data, estimate, estimate.groups[0], 0, 4))


def stated(plan: RobotPlan, data: SessionData, estimate: SessionEstimate) -> tuple[float, float]:
    """Return what the analysis itself says is uncertain: rms lengths (mm) and angles (rad)."""
    if plan is HAND_EYE:
        u = np.sqrt(np.diag(calibrate_session_hand_eye(data, estimate, nominal_prints=True).covariance))
        return math.sqrt(float(np.mean(u[:3] ** 2))), math.sqrt(float(np.mean(u[3:6] ** 2)))
    return chain_uncertainties(data, estimate)


def test_now_is_what_the_analysis_states_and_after_is_what_it_will_state(begun: Begun) -> None:
    found, views = begun.found, begun.views
    position, angle = stated(begun.plan, begun.data, begun.estimate)
    assert found.position_mm[0] == pytest.approx(position, rel=0.1)
    assert found.angle[0] == pytest.approx(angle, rel=0.1)
    assert np.all(np.diff(found.position_mm) <= 0.0)
    assert np.all(np.diff(found.angle) <= 0.0)
    assert found.joint_angles is not None
    more = dataclasses.replace(views, rng=np.random.default_rng(9))
    more.take(np.concatenate([views.joint_angles, found.joint_angles]))
    data = more.all()
    position, angle = stated(begun.plan, data, estimate_session(data, "pooled"))
    # The robot's scatter is estimated from some dozen poses: to a third.
    assert position == pytest.approx(found.position_mm[-1], rel=0.5)
    assert angle == pytest.approx(found.angle[-1], rel=0.5)


def test_the_robot_can_take_the_views(begun: Begun) -> None:
    found, arm, visited = begun.found, begun.views.arm, begun.views.joint_angles
    assert found.joint_angles is not None
    assert np.all(found.joint_angles >= visited.min(axis=0) - JOINT_MARGIN - 1e-9)
    assert np.all(found.joint_angles <= visited.max(axis=0) + JOINT_MARGIN + 1e-9)
    if begun.plan is HAND_EYE:  # with DH base and flange are those of the identified chain
        there = forward(arm.chain, found.joint_angles)
        off = np.linalg.norm(there[:, :3, 3] - found.T_base_flange[:, :3, 3], axis=1)
        assert off.max() < 1.0
    T = np.linalg.inv(arm.camera_poses(found.joint_angles))
    apart = np.linalg.norm(T[:, :3, 3] - found.T_camera_target[:, :3, 3], axis=1)
    assert apart.max() < 3.0


def test_no_view_is_beyond_the_limits_that_the_robot_states(begun: Begun) -> None:
    visited = begun.views.joint_angles
    free = begun.found.joint_angles
    assert free is not None
    assert np.any(free > visited.max(axis=0))
    limits = np.stack([np.full(6, math.nan), visited.max(axis=0)])
    suggest = begun.plan.suggest
    found = suggest(begun.data, begun.estimate, begun.estimate.groups[0], 0, 4, None, limits).joint_angles
    assert found is not None
    assert np.all(found <= limits[1])


@pytest.mark.parametrize("camera_mount", ["robot", "fixed"])
@pytest.mark.parametrize("joints", [3, 4, 5])
def test_an_arm_of_few_joints_has_views_within_its_reach(
    begun: Begun, joints: int, camera_mount: CameraMount
) -> None:
    """It reaches none of the poses that are drawn for an arm of six joints."""
    rows = [(0.0, 90.0, 350.0, 0.0), (300.0, 0.0, 0.0, 0.0), (250.0, 0.0, 0.0, 0.0), (60.0, 90.0, 0.0, 0.0)]
    chain = Chain.from_rows([*rows, (0.0, 0.0, 120.0, 0.0)][:joints])
    home = np.radians([10.0, 40.0, -60.0, -30.0, 15.0])[:joints]
    T_target_camera = begun.views.arm.camera_poses(begun.views.joint_angles)[0]
    T_moving_fixed = invert(T_target_camera) if camera_mount == "robot" else T_target_camera
    T_base_fixed = forward(chain, home[None])[0] @ T_FLANGE_CAMERA @ T_moving_fixed
    limits = np.stack([home - 0.2, np.full(joints, math.nan)])
    reach = RobotReach(chain, home + np.array([[-0.1], [0.1]]), limits)
    group = begun.estimate.groups[0]
    found = robot_candidates(group, BOARD, T_FLANGE_CAMERA, T_base_fixed, reach, camera_mount)
    q = found.joint_angles
    assert q is not None
    assert len(q) > 50
    assert np.all(q >= limits[0])
    assert np.all(np.abs(q - home) <= 0.1 + JOINT_MARGIN)
    np.testing.assert_allclose(found.T_base_flange, forward(chain, q), atol=1e-9)
    T_fixed_moving = invert(T_base_fixed) @ found.T_base_flange @ T_FLANGE_CAMERA
    T_camera_target = np.linalg.inv(T_fixed_moving) if camera_mount == "robot" else T_fixed_moving
    np.testing.assert_allclose(found.T_camera_target, T_camera_target, atol=1e-9)
    pixels = np.array([project(transform_points(T, BOARD.points_target()), CAMERA) for T in T_camera_target])
    assert np.all((pixels > 0.0) & (pixels < [WIDTH, HEIGHT]))
    assert np.all(T_camera_target[:, 2, 2] >= math.cos(MAX_TILT))


def test_of_stated_candidates_each_is_taken_once_and_those_without_the_target_never(begun: Begun) -> None:
    arm = begun.views.arm
    seen = viewing_angles(arm, np.random.default_rng(12), 6)
    away = seen[:2] + np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    stated = np.concatenate([away[:1], seen, away[1:]])
    suggest = begun.plan.suggest
    found = suggest(begun.data, begun.estimate, begun.estimate.groups[0], 0, 20, stated)
    assert found.joint_angles is not None
    assert found.stated is not None
    assert found.stated.tolist() == [1, 2, 3, 4, 5, 6]
    np.testing.assert_allclose(sorted(found.joint_angles[:, 0]), sorted(seen[:, 0]))
    T = np.linalg.inv(arm.camera_poses(found.joint_angles))
    assert np.linalg.norm(T[:, :3, 3] - found.T_camera_target[:, :3, 3], axis=1).max() < 3.0
    assert np.all(np.diff(found.position_mm) <= 0.0)
    if begun.plan is HAND_EYE:
        distance = calibrate_session_hand_eye(begun.data, begun.estimate).working_distance_mm

        def left(candidates: np.ndarray) -> float:
            first = suggest(begun.data, begun.estimate, begun.estimate.groups[0], 0, 1, candidates)
            return float(np.hypot(first.position_mm[1], distance * first.angle[1]))

        assert left(seen) == pytest.approx(min(left(one[None]) for one in seen), rel=1e-9)
    with pytest.raises(NoViewShowsTarget):
        suggest(begun.data, begun.estimate, begun.estimate.groups[0], 0, 1, away)


def test_expected_views_say_of_the_images_taken_what_the_session_says(begun: Begun) -> None:
    estimate = begun.estimate
    T = begun.views.arm.camera_poses(begun.views.joint_angles)
    expected = expected_views(begun.data, list(estimate.poses), estimate.groups[0], 0, np.linalg.inv(T))
    for own, common, pose in zip(expected.own, expected.common, estimate.poses, strict=True):
        known = pose.own_covariance()
        assert known is not None
        assert pose.common is not None
        np.testing.assert_allclose(np.diag(own), np.diag(known), rtol=0.1)
        shared = pose.common @ pose.common.T
        np.testing.assert_allclose(np.diag(common @ common.T), np.diag(shared), rtol=0.2)


def test_what_cannot_be_planned_is_refused(begun: Begun) -> None:
    with pytest.raises(InvalidArgument):
        begun.suggest(0)
    of_two = dataclasses.replace(begun.data, targets=(BOARD, BOARD), target_ids=("a", "b"))
    with pytest.raises(TooFewMeasurements):
        begun.suggest(1, target=1, data=of_two)


AT_MOST = {"hand_eye": 0.66, "dh": 0.55}
"""With hand-eye the shares of twelve sessions have the mean .59 and scatter by .04, those of four with DH have .46 and
scatter by .03. The means of three, and of two with DH, are uncertain by .023 and .021: the bounds are three and four of
these away."""


@pytest.mark.slow
@pytest.mark.parametrize("plan", [HAND_EYE, DH], ids=["hand_eye", "dh"])
def test_the_planned_order_needs_two_thirds_of_the_images_of_a_random_one(plan: RobotPlan) -> None:
    shares = [images_needed(plan, seed) for seed in range(3 if plan is HAND_EYE else 2)]
    print(f"images by the planned order over a random one: {np.round(shares, 2).tolist()}")
    assert np.mean(shares) <= AT_MOST["hand_eye" if plan is HAND_EYE else "dh"]
    assert max(shares) < 1.0


@pytest.mark.slow
def test_the_planned_order_is_an_image_or_two_from_the_best_choice_for_hand_eye() -> None:
    """The least is a broken number: an image is for rounding up, and one for learning the frames on the way."""
    for seed in range(3):
        assert images_needed(HAND_EYE, seed) <= least_mount_images(seed) + 2.0 / HAND_EYE.at_random
