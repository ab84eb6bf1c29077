"""Views that a robot can take: turned about the optical axis as a wrist does, and within where its joints have been.

An arm of fewer than six joints reaches hardly any pose that is drawn: its joint angles are drawn instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration import CommonFit
from core.errors import NoViewShowsTarget
from core.kinematics import Chain, forward, solve_inverse
from core.session.estimate import FocusGroup
from core.session.model import CameraMount
from core.session.next_view.candidates import MAX_TILT, candidate_views, shows_target
from core.session.next_view.views_expected import camera_of, common_fit, image_size
from core.targets import TargetSpec

WRIST_TURN = math.radians(90.0)
"""Largest turn about the optical axis, from the mean one of the images so far, where its joints are not known."""
JOINT_MARGIN = math.radians(20.0)
"""How far beyond the angles where a joint has been it may be asked to go: farther on nothing is known of what is in the
way."""
CANDIDATES = 1000
"""Views among which those of a robot are chosen. Of 200 the order needs 6 % more images; these take half a second."""
_TRIED = 5 * CANDIDATES // 2
_DRAWN = 20 * CANDIDATES
"""Joint angles drawn at random: where joints may go far, few of them show the target."""
_POSE_FREEDOM = 6
_SEED = 11


@dataclass(frozen=True)
class RobotReach:
    """An arm and the joint angles where it has been (rad).

    `limits` are the least and largest angles that may be stated for its joints (rad, NaN where there is no limit), the
    chain's being `coupling` times those that are stated; None where none are known.
    """

    chain: Chain
    visited: Float[np.ndarray, "k j"]
    limits: Float[np.ndarray, "2 j"] | None = None
    coupling: Float[np.ndarray, "j j"] | None = None

    def angles(
        self, T_base_flange: Float[np.ndarray, "n 4 4"]
    ) -> tuple[Float[np.ndarray, "n j"], Bool[np.ndarray, " n"]]:
        """Return joint angles that take the flange there, and where there are any within the range allowed."""
        found = solve_inverse(self.chain, T_base_flange, self.visited)
        return found.joint_angles, np.asarray(found.attained & self._allows(found.joint_angles))

    def drawn(self) -> Float[np.ndarray, "n j"]:
        """Return joint angles at random within the range allowed."""
        q = np.random.default_rng(_SEED).uniform(*self._range(), (_DRAWN, len(self.chain)))
        return q[self._allows(q)]

    def _range(self) -> tuple[Float[np.ndarray, " j"], Float[np.ndarray, " j"]]:
        return self.visited.min(axis=0) - JOINT_MARGIN, self.visited.max(axis=0) + JOINT_MARGIN

    def _allows(self, joint_angles: Float[np.ndarray, "n j"]) -> Bool[np.ndarray, " n"]:
        low, high = self._range()
        inside = np.all((joint_angles >= low) & (joint_angles <= high), axis=1)
        if self.limits is not None:
            C = np.eye(len(self.chain)) if self.coupling is None else self.coupling
            stated = np.linalg.solve(C, joint_angles.T).T
            inside &= ~np.any((stated < self.limits[0]) | (stated > self.limits[1]), axis=1)
        return np.asarray(inside)


@dataclass(frozen=True)
class RobotCandidates:
    """Views with the flange's pose in the robot's base, and joint angles (rad) where the arm is known.

    `stated` are their places among the joint angles that were stated as candidates; None where views are any that the
    robot can take.
    """

    T_camera_target: Float[np.ndarray, "n 4 4"]
    T_base_flange: Float[np.ndarray, "n 4 4"]
    joint_angles: Float[np.ndarray, "n j"] | None
    stated: Int[np.ndarray, " n"] | None = None


def robot_candidates(
    group: FocusGroup,
    spec: TargetSpec,
    T_flange_moving: Float[np.ndarray, "4 4"],
    T_base_fixed: Float[np.ndarray, "4 4"],
    reach: RobotReach | None,
    camera_mount: CameraMount = "robot",
) -> RobotCandidates:
    """Return views of a target that the robot can take, `CANDIDATES` of them or fewer.

    The camera moves with the flange before a fixed target, or the target before a fixed camera.

    Raises NoViewShowsTarget where no view is within reach, TooFewMeasurements for a group without a common camera.
    """
    fit = common_fit(group)
    seen = spec, camera_of(fit), image_size(fit)
    angles = None
    if reach is not None and len(reach.chain) < _POSE_FREEDOM:
        angles = reach.drawn()
        flange = forward(reach.chain, angles)
        views = _views_at(flange, T_flange_moving, T_base_fixed, camera_mount)
        there = shows_target(views, *seen) & (views[:, 2, 2] >= math.cos(MAX_TILT))
    else:
        wanted, turn = (CANDIDATES, WRIST_TURN) if reach is None else (_TRIED, math.pi)
        views = candidate_views(*seen, wanted, turns=(_mean_turn(fit), turn))
        T_fixed_moving = np.linalg.inv(views) if camera_mount == "robot" else views
        flange = T_base_fixed @ T_fixed_moving @ np.linalg.inv(T_flange_moving)
        there = np.ones(len(views), dtype=np.bool_)
        if reach is not None and len(views):
            angles, there = reach.angles(flange)
    kept = np.flatnonzero(there)[:CANDIDATES]
    if not len(kept):
        raise NoViewShowsTarget(
            "No view within the robot's reach shows the whole target.",
            "Use a smaller target, put it nearer the middle of the poses, or take images with joints farther apart.",
        )
    return RobotCandidates(views[kept], flange[kept], None if angles is None else angles[kept])


def stated_candidates(
    group: FocusGroup,
    spec: TargetSpec,
    T_flange_moving: Float[np.ndarray, "4 4"],
    T_base_fixed: Float[np.ndarray, "4 4"],
    chain: Chain,
    joint_angles: Float[np.ndarray, "n j"],
    camera_mount: CameraMount,
) -> RobotCandidates:
    """Return the views at joint angles (rad) of the robot's model that show the whole target.

    Raises NoViewShowsTarget where none does, TooFewMeasurements for a group without a common camera.
    """
    fit = common_fit(group)
    flange = forward(chain, joint_angles)
    views = _views_at(flange, T_flange_moving, T_base_fixed, camera_mount)
    kept = np.flatnonzero(shows_target(views, spec, camera_of(fit), image_size(fit)))
    if not len(kept):
        raise NoViewShowsTarget(
            "No candidate shows the whole target.",
            "State joint angles at which the camera sees the target with a square's width around it.",
        )
    return RobotCandidates(views[kept], flange[kept], joint_angles[kept], kept)


def _views_at(
    T_base_flange: Float[np.ndarray, "n 4 4"],
    T_flange_moving: Float[np.ndarray, "4 4"],
    T_base_fixed: Float[np.ndarray, "4 4"],
    camera_mount: CameraMount,
) -> Float[np.ndarray, "n 4 4"]:
    """Return T_camera_target."""
    T_fixed_moving = np.linalg.inv(T_base_fixed) @ T_base_flange @ T_flange_moving
    return np.linalg.inv(T_fixed_moving) if camera_mount == "robot" else T_fixed_moving


def _mean_turn(fit: CommonFit) -> float:
    """Return the mean direction of the targets' rows in the images, rad."""
    R = fit.placements.rotations
    angle = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    return math.atan2(float(np.sin(angle).mean()), float(np.cos(angle).mean()))
