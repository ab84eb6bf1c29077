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
from jaxtyping import Float

from core.calibration import HandEyeObservation, information_so_far, station_information
from core.errors import TooFewMeasurements
from core.kinematics import ModelChoice, PoseData, forward, pose_information
from core.session.commanded_poses import calibrate_session_hand_eye
from core.session.estimate import FocusGroup, SessionEstimate
from core.session.model import SessionData
from core.session.next_view.reach import RobotCandidates, RobotReach, robot_candidates
from core.session.next_view.selection import greedy
from core.session.next_view.views_expected import expected_views
from core.session.robot import gather_robot_poses, identify_robot

MAX_BASE_OFFSET_MM = 5.0
"""Median distance between commanded flanges and those of the nominal robot up to which both have the same base."""


@dataclass(frozen=True, slots=True)
class NextRobotViews:
    """Views to take, the most informative first: T_camera_target and T_base_flange (mm), joint angles of the robot's
    model (rad; None where the arm is not known), and what each leaves uncertain.

    `position_mm` and `angle` (rad) begin with what is uncertain now and have an entry more for each view: root mean
    squares over the axes of the camera on the flange (the target there, of a fixed camera), or over the chain's lengths
    and angles.
    """

    T_camera_target: Float[np.ndarray, "n 4 4"]
    T_base_flange: Float[np.ndarray, "n 4 4"]
    joint_angles: Float[np.ndarray, "n j"] | None
    position_mm: Float[np.ndarray, " m"]
    angle: Float[np.ndarray, " m"]


def suggest_hand_eye_views(
    data: SessionData, estimate: SessionEstimate, group: FocusGroup, target: int, count: int
) -> NextRobotViews:
    """Suggest `count` views of a target, by its place in the session, that make the camera on the flange certain.

    Where the robot is known and its base is that of the commanded poses, views are those within its joints' range.

    Raises what `calibrate_session_hand_eye` raises, TooFewMeasurements where no image shows the target or the group has
    no common camera, and InvalidArgument for no views and where none is within reach.
    """
    found = calibrate_session_hand_eye(data, estimate)
    tie, place = found.calibration, _place(target, found.targets)
    frames = tie.T_flange_camera, tie.T_base_targets[place]
    candidates = robot_candidates(
        group, data.targets[target], *frames, _commanded_reach(data), data.camera_mount
    )
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
    chosen, left = greedy(M, information, np.diag(weight), count)
    return _views(candidates, chosen, left, np.arange(3), np.arange(3, 6))


def suggest_dh_views(
    data: SessionData, estimate: SessionEstimate, group: FocusGroup, target: int, count: int
) -> NextRobotViews:
    """Suggest `count` views of a target, by its place in the session, that make the robot's chain certain.

    Raises what `identify_robot` raises, TooFewMeasurements where no image shows the target or the group has no common
    camera, and InvalidArgument for no views and where none is within reach.
    """
    found = identify_robot(data, estimate, model=ModelChoice.DH)
    gathered = gather_robot_poses(data, estimate)
    place = _place(target, found.targets)
    frames = found.T_flange_camera, np.linalg.inv(found.T_target_base[place])
    reach = RobotReach(found.chain, gathered.poses.joint_angles)
    candidates = robot_candidates(group, data.targets[target], *frames, reach, data.camera_mount)
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
    chosen, left = greedy(known.measured, information, np.diag(weight), count)
    return _views(candidates, chosen, left, np.flatnonzero(known.lengths), np.flatnonzero(known.angles))


def _place(target: int, targets: Sequence[int]) -> int:
    if target not in targets:
        raise TooFewMeasurements(
            "No image that counts shows this target.", "Take images of it, or name a target that was seen."
        )
    return targets.index(target)


def _commanded_reach(data: SessionData) -> RobotReach | None:
    """Return the nominal robot at the commanded joint angles; None where its flange is not where it was commanded."""
    if data.nominal is None:
        return None
    known = [
        c
        for c in data.commanded.values()
        if c.joint_angles_deg is not None and len(c.joint_angles_deg) == len(data.nominal)
    ]
    if not known:
        return None
    q = data.model_angles(np.array([c.joint_angles_deg for c in known], dtype=np.float64))
    stated = np.array([c.position_mm if c.position_mm is not None else [math.nan] * 3 for c in known])
    off = np.linalg.norm(forward(data.nominal, q)[:, :3, 3] - stated, axis=1)
    off = off[np.isfinite(off)]
    if len(off) and float(np.median(off)) > MAX_BASE_OFFSET_MM:
        return None
    return RobotReach(data.nominal, q)


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
    )
