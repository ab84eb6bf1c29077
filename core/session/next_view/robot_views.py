"""The next views for hand-eye calibration and for Denavit-Hartenberg parameters.

As for the camera (`suggestion`), of many candidates the one is taken, again and again, that leaves least uncertain what
is asked for: the camera on the flange, positions in mm and rotations at the working distance; or the chain's lengths
and angles, these at the end of the arm. The errors that all poses share are parts of the state: a view says something
of the lens, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.calibration import HandEyeObservation, information_so_far, station_information
from core.errors import JointAnglesMissing, NominalRobotMissing, RobotBaseMismatch, TooFewMeasurements
from core.kinematics import ModelChoice, PoseData, forward, pose_information
from core.session.commanded_poses import SessionHandEye, calibrate_session_hand_eye
from core.session.estimate import FocusGroup, SessionEstimate
from core.session.model import CommandedPose, SessionData
from core.session.next_view.reach import RobotCandidates, RobotReach, robot_candidates, stated_candidates
from core.session.next_view.selection import greedy
from core.session.next_view.views_expected import expected_views
from core.session.robot import gather_robot_poses, identify_robot

MAX_BASE_OFFSET_MM = 5.0
"""Median distance between commanded flanges and those of the nominal robot up to which both have the same base."""


@dataclass(frozen=True, slots=True)
class NextRobotViews:
    """Views to take, the most informative first: T_camera_target and T_base_flange (mm), joint angles of the robot's
    model (rad; None where the arm is not known), and what each leaves uncertain.

    `stated` are the places of those that show the target among candidates that were stated; None where none were.
    `position_mm` and `angle` (rad) begin with what is uncertain now and have an entry more for each view: root mean
    squares over the axes of the camera on the flange (the target there, of a fixed camera), or over the chain's lengths
    and angles.
    """

    T_camera_target: Float[np.ndarray, "n 4 4"]
    T_base_flange: Float[np.ndarray, "n 4 4"]
    joint_angles: Float[np.ndarray, "n j"] | None
    position_mm: Float[np.ndarray, " m"]
    angle: Float[np.ndarray, " m"]
    stated: Int[np.ndarray, " k"] | None


def suggest_hand_eye_views(
    data: SessionData,
    estimate: SessionEstimate,
    group: FocusGroup,
    target: int,
    count: int,
    stated: Float[np.ndarray, "n j"] | None = None,
    limits: Float[np.ndarray, "2 j"] | None = None,
) -> NextRobotViews:
    """Suggest `count` views of a target, by its place in the session, that make the camera on the flange certain.

    Where the robot is known and its base is that of the commanded poses, views are those within its joints' range and
    the `limits` of stated angles (rad, NaN without a limit); of joint angles `stated` (rad, of the robot's model),
    each once at most.

    Raises what `views_of_candidates` and `calibrate_session_hand_eye` raise, TooFewMeasurements where no image shows
    the target or the group has no common camera, InvalidArgument for no views, and NoViewShowsTarget where none is
    within reach.
    """
    found = calibrate_session_hand_eye(data, estimate, nominal_prints=True)
    tie, place = found.calibration, _place(target, found.targets)
    frames = tie.T_flange_camera, tie.T_base_targets[place]
    if stated is None:
        reach = _commanded_reach(data, limits)
        candidates = robot_candidates(group, data.targets[target], *frames, reach, data.camera_mount)
    else:
        candidates = _stated_views(data, found, group, target, stated)
    counted = [pose for pose in estimate.poses if pose.measurement_id not in estimate.unclear]
    expected = expected_views(data, counted, group, target, candidates.T_camera_target)
    stations = [
        HandEyeObservation("", T, moving, own, common, place)
        for T, moving, own, common in zip(
            candidates.T_base_flange, expected.T_fixed_moving, expected.own, expected.common, strict=True
        )
    ]
    M = information_so_far(tie, found.covariance - tie.common @ tie.common.T)
    weight = np.zeros(len(M))
    weight[:6] = [1.0] * 3 + [found.working_distance_mm**2] * 3
    information = station_information(tie, stations) + expected.of_shared(len(M))
    chosen, left = greedy(M, information, np.diag(weight), count, repeat=stated is None)
    return _views(candidates, chosen, left, np.arange(3), np.arange(3, 6))


def suggest_dh_views(
    data: SessionData,
    estimate: SessionEstimate,
    group: FocusGroup,
    target: int,
    count: int,
    stated: Float[np.ndarray, "n j"] | None = None,
    limits: Float[np.ndarray, "2 j"] | None = None,
) -> NextRobotViews:
    """Suggest `count` views of a target, by its place in the session, that make the robot's chain certain.

    Views are within its joints' range and the `limits` of stated angles (rad, NaN without a limit), or of joint
    angles `stated` (rad, of the robot's model), each once at most.

    Raises what `identify_robot` raises, TooFewMeasurements where no image shows the target or the group has no common
    camera, InvalidArgument for no views, and NoViewShowsTarget where none is within reach.
    """
    found = identify_robot(data, estimate, model=ModelChoice.DH)
    gathered = gather_robot_poses(data, estimate, nominal_prints=True)
    place = _place(target, found.targets)
    frames = found.T_flange_camera, np.linalg.inv(found.T_target_base[place])
    spec = data.targets[target]
    if stated is None:
        reach = RobotReach(found.chain, gathered.poses.joint_angles, limits, data.joint_coupling)
        candidates = robot_candidates(group, spec, *frames, reach, data.camera_mount)
    else:
        candidates = stated_candidates(group, spec, *frames, found.chain, stated, data.camera_mount)
    assert candidates.joint_angles is not None  # within reach
    counted = [estimate.poses[i] for i in gathered.rows]
    expected = expected_views(data, counted, group, target, candidates.T_camera_target)
    T = expected.T_fixed_moving
    known = pose_information(
        found.chain,
        found.T_flange_camera,
        found.T_target_base,
        gathered.poses,
        PoseData(
            candidates.joint_angles,
            T[:, :3, 3],
            T[:, :3, :3],
            expected.own,
            expected.common,
            np.full(len(T), place, dtype=np.intp),
        ),
        (found.scatter_mm, found.scatter_rad or 0.0),
    )
    weight = known.lengths / max(int(known.lengths.sum()), 1)
    weight = weight + known.reach_mm**2 * known.angles / max(int(known.angles.sum()), 1)
    information = known.candidates + expected.of_shared(len(known.measured))
    chosen, left = greedy(known.measured, information, np.diag(weight), count, repeat=stated is None)
    return _views(candidates, chosen, left, np.flatnonzero(known.lengths), np.flatnonzero(known.angles))


def views_of_candidates(
    data: SessionData,
    estimate: SessionEstimate,
    group: FocusGroup,
    target: int,
    stated: Float[np.ndarray, "n j"],
) -> RobotCandidates:
    """Return the views of a target, by its place in the session, at joint angles (rad) of the nominal robot.

    Raises what `calibrate_session_hand_eye` raises, NominalRobotMissing, JointAnglesMissing, RobotBaseMismatch where
    its base is not that of the commanded poses, NoViewShowsTarget, and TooFewMeasurements where no image shows the
    target or the group has no common camera.
    """
    return _stated_views(
        data, calibrate_session_hand_eye(data, estimate, nominal_prints=True), group, target, stated
    )


def _stated_views(
    data: SessionData,
    found: SessionHandEye,
    group: FocusGroup,
    target: int,
    stated: Float[np.ndarray, "n j"],
) -> RobotCandidates:
    if data.nominal is None:
        raise NominalRobotMissing("Joint angles are no views without the robot's model.")
    if not _with_joint_angles(data):
        raise JointAnglesMissing(
            "No commanded pose has joint angles, so that it is not known whether the robot's model has their base.",
            "State joint_angles_deg with the commanded poses.",
        )
    if _commanded_reach(data) is None:
        raise RobotBaseMismatch(
            "The robot's model and its commanded poses have different bases: joint angles are no views.",
            "State commanded poses in the base of the robot's Denavit-Hartenberg model, or ask with purpose dh.",
        )
    tie = found.calibration
    frames = tie.T_flange_camera, tie.T_base_targets[_place(target, found.targets)]
    return stated_candidates(group, data.targets[target], *frames, data.nominal, stated, data.camera_mount)


def _place(target: int, targets: Sequence[int]) -> int:
    if target not in targets:
        raise TooFewMeasurements(
            "No image that counts shows this target.", "Take images of it, or name a target that was seen."
        )
    return targets.index(target)


def _with_joint_angles(data: SessionData) -> list[CommandedPose]:
    """Return the commanded poses that state an angle for each joint of the nominal robot."""
    joints = -1 if data.nominal is None else len(data.nominal)
    return [c for c in data.commanded.values() if len(c.joint_angles_deg or ()) == joints]


def _commanded_reach(data: SessionData, limits: Float[np.ndarray, "2 j"] | None = None) -> RobotReach | None:
    """Return the nominal robot at the commanded joint angles; None where its flange is not where it was commanded."""
    known = _with_joint_angles(data)
    if data.nominal is None or not known:
        return None
    q = data.model_angles(np.array([c.joint_angles_deg for c in known], dtype=np.float64))
    stated = np.array([c.position_mm if c.position_mm is not None else [math.nan] * 3 for c in known])
    off = np.linalg.norm(forward(data.nominal, q)[:, :3, 3] - stated, axis=1)
    off = off[np.isfinite(off)]
    if len(off) and float(np.median(off)) > MAX_BASE_OFFSET_MM:
        return None
    return RobotReach(data.nominal, q, limits, data.joint_coupling)


def _views(
    candidates: RobotCandidates,
    chosen: Sequence[int],
    left: Sequence[Float[np.ndarray, "f f"]],
    lengths: np.ndarray,
    angles: np.ndarray,
) -> NextRobotViews:
    """Return the candidates chosen with the root mean square uncertainties of some lengths and angles."""
    q = candidates.joint_angles
    variances = np.array([np.diag(C) for C in left])
    return NextRobotViews(
        candidates.T_camera_target[chosen],
        candidates.T_base_flange[chosen],
        None if q is None else q[chosen],
        np.sqrt(variances[:, lengths].mean(axis=1)),
        np.sqrt(variances[:, angles].mean(axis=1)),
        candidates.stated,
    )
