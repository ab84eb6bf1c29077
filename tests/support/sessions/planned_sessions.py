"""How many images reach a given uncertainty: in the order that next views suggest, and in a random one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float

from core.calibration import HandEyeCalibration, HandEyeObservation, estimate_group, station_information
from core.geometry import invert, transform
from core.kinematics import ModelChoice
from core.numerics import covariance_of
from core.session import (
    NextRobotViews,
    SessionData,
    SessionEstimate,
    calibrate_session_hand_eye,
    estimate_session,
    identify_robot,
    suggest_dh_views,
    suggest_hand_eye_views,
    suggest_views,
)
from core.session.next_view import candidate_views, projection_jacobian
from core.session.next_view.information import simulated_views
from core.session.next_view.reach import JOINT_MARGIN, RobotReach, robot_candidates
from core.session.next_view.views_expected import expected_views
from core.session.robot import shared_errors
from tests.support.sessions.arm_views import (
    SCATTER_MM,
    SCATTER_RAD,
    ArmViews,
    arm_before_board,
    viewing_angles,
)
from tests.support.sessions.stored_sessions import BOARD, CAMERA, HEIGHT, WIDTH

NOISE_PX = 0.1
_DESIGN_STEPS = 200
_DEVIATIONS = (0.2, 2e-4)
"""Of what the arm attains from what it is commanded (mm, rad)."""
_REACH_MM = 1500.0
"""Where an angle of the chain counts."""


@dataclass(frozen=True)
class RobotPlan:
    """A purpose: how many images begin a session, how many the random order has, and what is to become certain.

    `uncertainty` is in mm: lengths, and angles at the distance where they count. `deviations` are of what the arm
    attains from what it is commanded (mm, rad); `as_built` whether the arm departs from its data sheet.
    """

    begun: int
    at_random: int
    uncertainty: Callable[[SessionData, SessionEstimate], float]
    suggest: Callable[..., NextRobotViews]
    deviations: tuple[float, float]
    as_built: bool


def _of_mount(data: SessionData, estimate: SessionEstimate) -> float:
    information, weight = mount_information(data, estimate)
    together = information.sum(axis=0) + _of_lens(len(weight))
    return math.sqrt(float(np.diag(covariance_of(together)) @ weight))


def mount_information(
    data: SessionData, estimate: SessionEstimate
) -> tuple[Float[np.ndarray, "n q q"], Float[np.ndarray, " q"]]:
    """Return what each image says of the frames and the shared errors, and the weight of each part of the state: 1 and
    the square of the working distance (mm) for the camera on the flange.

    It is at the deviations that the robot truly has: those estimated from a few poses scatter by a third.
    """
    found = calibrate_session_hand_eye(data, estimate, nominal_prints=True)
    tie = true_tie(found.calibration)
    common = shared_errors(estimate.poses)
    assert common is not None
    stations = []
    for pose, shared in zip(estimate.poses, common, strict=True):
        own = pose.own_covariance()
        assert pose.rotation is not None
        assert own is not None
        T = transform(pose.rotation, pose.position_mm)
        attained = tie.T_base_targets[0] @ T @ invert(tie.T_flange_camera)
        stations.append(HandEyeObservation(pose.pose_id, attained, T, own, shared))
    information = station_information(tie, stations)
    weight = np.zeros(information.shape[1])
    weight[:6] = [1.0] * 3 + [found.working_distance_mm**2] * 3
    return information, weight


def true_tie(tie: HandEyeCalibration) -> HandEyeCalibration:
    """Return a calibration with the deviations that the robot truly has."""
    deviations = math.hypot(_DEVIATIONS[0], SCATTER_MM), math.hypot(_DEVIATIONS[1], SCATTER_RAD)
    return replace(tie, robot_position_mm=deviations[0], robot_rotation=deviations[1])


def _of_lens(size: int) -> Float[np.ndarray, "q q"]:
    """Return what all images together say of the shared errors, which are the lens's."""
    return np.diag(np.where(np.arange(size) < 12, 0.0, 1.0))


def _of_chain(data: SessionData, estimate: SessionEstimate) -> float:
    lengths, angles = chain_uncertainties(data, estimate)
    return math.hypot(lengths, _REACH_MM * angles)


def chain_uncertainties(data: SessionData, estimate: SessionEstimate) -> tuple[float, float]:
    """Return the root mean squares of the uncertainties of a chain's lengths (mm) and angles (rad)."""
    joints = identify_robot(data, estimate, model=ModelChoice.DH).joints
    known = [item for joint in joints for item in joint.estimate.standard_uncertainty.items()]
    lengths = [u**2 for name, u in known if u is not None and name.endswith("_mm")]
    angles = [u**2 for name, u in known if u is not None and name.endswith("_rad")]
    return math.sqrt(float(np.mean(lengths))), math.sqrt(float(np.mean(angles)))


HAND_EYE = RobotPlan(4, 24, _of_mount, suggest_hand_eye_views, _DEVIATIONS, as_built=False)
DH = RobotPlan(12, 40, _of_chain, suggest_dh_views, (0.0, 0.0), as_built=True)


@cache
def images_needed(plan: RobotPlan, seed: int) -> float:
    """Return the images that the planned order needs for what `plan.at_random` random ones reach, as their share.

    Images are suggested one at a time, from what is known so far; both orders begin with the same ones, and neither may
    move a joint farther beyond where it has been than `JOINT_MARGIN`.
    """
    views = views_at_random(plan, seed)
    everything = views.all()
    aim = plan.uncertainty(everything, estimate_session(everything, "pooled"))
    views.keep(plan.begun)
    for count in range(plan.begun, plan.at_random):
        data = views.all()
        estimate = estimate_session(data, "pooled")
        if plan.uncertainty(data, estimate) <= aim:
            return count / plan.at_random
        one = plan.suggest(data, estimate, estimate.groups[0], 0, 1)
        assert one.joint_angles is not None
        views.take(one.joint_angles)
    return 1.0


def views_at_random(plan: RobotPlan, seed: int) -> ArmViews:
    """Return a session of the random order."""
    rng = np.random.default_rng(seed)
    views = ArmViews(arm_before_board(rng, as_built=plan.as_built), rng, *plan.deviations)
    views.take(viewing_angles(views.arm, rng, plan.begun))
    for _ in range(plan.begun, plan.at_random):
        q = views.joint_angles
        limits = np.column_stack([q.min(axis=0) - JOINT_MARGIN, q.max(axis=0) + JOINT_MARGIN])
        views.take(viewing_angles(views.arm, rng, 1, limits))
    return views


def least_mount_images(seed: int) -> float:
    """Return the least images that any choice needs for what the random order of `HAND_EYE` reaches, as their share.

    It is of the approximate design: with the images that begin a session, a whole or broken number of each candidate,
    all that the random order's joints allow, so that tr(G C) is least (A-optimality). The weights are found by the
    multiplicative algorithm. Nothing has to be learnt on the way: no planner needs fewer.

    References: S. D. Silvey, D. M. Titterington, B. Torsney, Communications in Statistics A 7 (1978) 1379-1389.
    """
    views = views_at_random(HAND_EYE, seed)
    data = views.all()
    estimate = estimate_session(data, "pooled")
    found = calibrate_session_hand_eye(data, estimate, nominal_prints=True)
    taken, weight = mount_information(data, estimate)
    shared, G = _of_lens(len(weight)), np.diag(weight)
    aim = float(np.trace(covariance_of(taken.sum(axis=0) + shared) @ G))
    tie, group = true_tie(found.calibration), estimate.groups[0]
    reach = RobotReach(views.arm.chain, views.joint_angles)
    at = robot_candidates(group, BOARD, tie.T_flange_camera, tie.T_base_targets[0], reach)
    expected = expected_views(data, list(estimate.poses), group, 0, at.T_camera_target)
    stations = [
        HandEyeObservation("", T, invert(view), own, common)
        for T, view, own, common in zip(
            at.T_base_flange, at.T_camera_target, expected.own, expected.common, strict=True
        )
    ]
    pool = station_information(tie, stations)
    begun = taken[: HAND_EYE.begun].sum(axis=0) + shared
    least, most = 0.0, float(HAND_EYE.at_random)
    while most - least > 0.1:
        middle = 0.5 * (least + most)
        if _optimal_trace(begun, middle * pool, G) <= aim:
            most = middle
        else:
            least = middle
    return (HAND_EYE.begun + least) / HAND_EYE.at_random


def _optimal_trace(
    M: Float[np.ndarray, "q q"], pool: Float[np.ndarray, "n q q"], G: Float[np.ndarray, "q q"]
) -> float:
    """Return the least tr(G (M + Σ w Λ)⁻¹) over weights w that sum to one."""
    w = np.full(len(pool), 1.0 / len(pool))
    for _ in range(_DESIGN_STEPS):
        C = covariance_of(M + np.einsum("n,nij->ij", w, pool))
        w *= np.sqrt(np.einsum("nij,ji->n", pool, C @ G @ C))
        w /= w.sum()
    return float(np.trace(covariance_of(M + np.einsum("n,nij->ij", w, pool)) @ G))


def camera_images_needed(seed: int, begun: int = 4, at_random: int = 20) -> float:
    """Return the same for the camera alone: the uncertainty of a pixel over the image."""
    size = (WIDTH, HEIGHT)
    rng = np.random.default_rng(seed)
    J = projection_jacobian(CAMERA, size, 8)
    G = J.T @ J / len(J)
    at = candidate_views(BOARD, CAMERA, size, at_random, seed=1000 + seed)
    random = simulated_views(BOARD, CAMERA, size, at, NOISE_PX, rng)
    aim = float(np.sum(G * estimate_group(random, "pooled").camera_covariance[:8, :8]))
    views = random[:begun]
    for count in range(begun, at_random):
        found = estimate_group(views, "pooled")
        if float(np.sum(G * found.camera_covariance[:8, :8])) <= aim:
            return count / at_random
        assert found.fit is not None
        one = suggest_views(found.fit, found.camera_covariance, BOARD, 1)
        views = [*views, *simulated_views(BOARD, CAMERA, size, one.T_camera_target, NOISE_PX, rng)]
    return 1.0
