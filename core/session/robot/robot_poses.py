"""Observations for a robot's identification: a session's poses that carry joint angles."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from core.calibration import number_labels
from core.errors import (
    Advisory,
    JointAnglesMissing,
    TooManyMeasurements,
)
from core.geometry import rotation_to_rpy
from core.kinematics import PoseData, forward, stack_joint_angles
from core.session.absolute_poses import absolute_poses, stacked_errors, unstated_scale_warnings
from core.session.camera_mount import check_one_on_flange, moving_poses
from core.session.estimate import ExcludedMeasurement, SessionEstimate
from core.session.model import MeasuredPose, SessionData, readings
from core.session.robot.last_moves import last_moves, measuring_order
from core.session.robot.stated_angles import (
    angles_of,
    excluded_for_angles,
    excluded_poses,
    refuse_wrong_numbers,
    without_angles,
)
from core.session.visits import burst_stops, merge_bursts, positions_of, rotations_of, stack_all

MAX_POSES = 20_000
"""Of one identification, which takes some 20 kB for each."""
_NO_ROTATION = "It has no rotation, while most have one."


@dataclass(frozen=True, slots=True)
class RobotPoses:
    """Poses ready for identification.

    `targets` are the places, in the session's list, of the targets that `poses.target` counts, `rows` those of the
    images among the session's estimate, and `stops` the visits that `poses` are of; all are empty for another
    instrument. `order` are the poses as they were measured, empty where that is not known. `excluded` are the
    measurements that are not among `poses`.
    """

    poses: PoseData
    targets: tuple[int, ...]
    rows: Int[np.ndarray, " n"]
    stops: tuple[MeasuredPose, ...]
    order: Int[np.ndarray, " k"]
    excluded: tuple[ExcludedMeasurement, ...]
    warnings: tuple[Advisory, ...]


def gather_robot_poses(
    data: SessionData, estimate: SessionEstimate | None, *, nominal_prints: bool = False
) -> RobotPoses:
    """Return another instrument's poses, or those of the estimate where images were taken and no such poses are there.

    `nominal_prints` as of `poses_of_estimate`. Raises as `poses_of_readings` and `poses_of_estimate` do.
    """
    if estimate is None or data.measured:
        return poses_of_readings(data)
    return poses_of_estimate(data, estimate, nominal_prints=nominal_prints)


def poses_of_estimate(
    data: SessionData, estimate: SessionEstimate, *, nominal_prints: bool = False
) -> RobotPoses:
    """Return the estimated poses of images that carry joint angles; the images of one stop are one pose, their mean.

    Their lens and prints are errors that they share, which an identification solves for along with the robot: what the
    chain knows of where the camera was says how the print is bowed, and what the lens is. With `nominal_prints` the
    prints are taken as their nominal grids, as plans of further views do, and the scatter of repeated poses may.

    Raises JointAnglesMissing where none does, TooManyMeasurements, JointAnglesInconsistent where their joints are not
    the robot's, SeveralTargetsOnFlange.
    """
    _check_size(len(data.images))
    angles = [angles_of(data, pose) for pose in estimate.poses]
    keep = [
        i
        for i, pose in enumerate(estimate.poses)
        if angles[i] is not None and pose.measurement_id not in estimate.unclear
    ]
    if not keep:
        refuse_wrong_numbers(data, estimate.poses)
        raise JointAnglesMissing(
            f"None of the {len(estimate.poses)} images that serve carries joint angles, nor does its pose.",
            "Send joint_angles_deg with the poses (POST .../poses, or `gridpose poses load`), or with the images.",
        )
    check_one_on_flange(data, [estimate.poses[i] for i in keep])
    counted = [estimate.poses[i] for i in keep]
    if not nominal_prints:
        absolute = absolute_poses(data, estimate).poses
        counted = [absolute[pose.measurement_id] for pose in counted]
    several = burst_stops(counted)
    # The robot did not move within a stop: its scatter is in it once.
    chosen = merge_bursts(moving_poses(data, counted))
    joint_angles, order = _joint_angles(data, chosen), measuring_order(data, chosen)
    targets = tuple(sorted({pose.frame for pose in chosen}))
    poses = PoseData(
        joint_angles,
        positions_of(chosen),
        np.array([pose.rotation for pose in chosen]),
        np.array([semidefinite(own) for pose in chosen if (own := pose.own_covariance()) is not None]),
        shared_errors(chosen) if nominal_prints else stacked_errors(chosen),
        np.array([targets.index(pose.frame) for pose in chosen], dtype=np.intp),
        tuple(pose.pose_id for pose in chosen),
        # Several targets at one stop are as many poses.
        number_labels(_photograph(p, several) for p in chosen),
        last_moves(order, joint_angles),
    )
    without = [pose for pose, known in zip(estimate.poses, angles, strict=True) if known is None]
    warnings = (
        *estimate.warnings,
        *unstated_scale_warnings(data, estimate, estimate.shapes),
        *without_angles(data, without, frozenset()),
    )
    excluded = (
        *estimate.excluded.values(),
        *estimate.unclear.values(),
        *(excluded_for_angles(data, pose) for pose in without),
    )
    return RobotPoses(poses, targets, np.array(keep, dtype=np.intp), tuple(chosen), order, excluded, warnings)


def _photograph(pose: MeasuredPose, several: Set[tuple[str, int | None]]) -> tuple[str, int | None, str]:
    """Return what names the image that shows a pose, or the stop: its focus group's images there."""
    if pose.image is None:
        return pose.pose_id, pose.cycle, ""
    at_stop = (pose.pose_id, pose.cycle) in several
    return pose.pose_id, pose.cycle, pose.image.focus_group if at_stop else pose.image.image


def semidefinite(covariance: Float[np.ndarray, "6 6"]) -> Float[np.ndarray, "6 6"]:
    """Return the covariance with what rounding to few digits left of asymmetry and negative eigenvalues taken off."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(scale > 0.0, scale, 1.0)
    correlation = np.where(np.outer(scale, scale) > 0.0, covariance / np.outer(unit, unit), 0.0)
    values, vectors = np.linalg.eigh((correlation + correlation.T) / 2.0)
    if values[0] >= 0.0:
        mended = (correlation + correlation.T) / 2.0
    else:
        mended = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(mended * np.outer(scale, scale))


def with_nominal_orientations(data: SessionData) -> SessionData:
    """Return the session with the nominal robot's orientations for poses that were commanded by joint angles alone.

    They decide how a board is labelled that looks the same when turned; how the flange is turned to the camera does not
    matter there.
    """
    if data.nominal is None:
        return data
    joints = len(data.nominal)
    by_joints = {
        pose_id: c
        for pose_id, c in data.commanded.items()
        if c.roll_deg is None and c.joint_angles_deg is not None and len(c.joint_angles_deg) == joints
    }
    if not by_joints:
        return data
    q = data.model_angles(np.array([c.joint_angles_deg for c in by_joints.values()], dtype=np.float64))
    commanded = dict(data.commanded)
    for (pose_id, c), T in zip(by_joints.items(), forward(data.nominal, q), strict=True):
        roll, pitch, yaw = np.degrees(rotation_to_rpy(T[:3, :3])).tolist()
        commanded[pose_id] = replace(c, roll_deg=roll, pitch_deg=pitch, yaw_deg=yaw)
    return replace(data, commanded=commanded)


def poses_of_readings(data: SessionData) -> RobotPoses:
    """Return what another instrument measured at known joint angles.

    Raises as `readings` and `poses_of_estimate` do.
    """
    visits = readings(data)
    _check_size(len(visits))
    warnings: list[Advisory] = []
    known = [v for v in visits if angles_of(data, v) is not None]
    if not known:
        refuse_wrong_numbers(data, visits)
        raise JointAnglesMissing(
            f"None of the {len(visits)} measured poses carries joint angles.",
            "Send joint_angles_deg with the commanded poses of the same pose_id (POST .../poses, or `gridpose poses "
            "load` with pose_id, j1_deg, j2_deg, ...): the readings stay as they are. To send them with the readings "
            "instead, delete these first (DELETE .../measured-poses, or `gridpose measured-poses delete SESSION "
            "--all`): without a cycle each would be stored a second time.",
        )
    without = [v for v in visits if angles_of(data, v) is None]
    excluded = [excluded_for_angles(data, v) for v in without]
    warnings += without_angles(data, without, frozenset(v.pose_id for v in known))
    turned = [v for v in known if v.rotation is not None]
    if turned and 2 * len(turned) >= len(known):
        warnings += excluded_poses(
            [v.pose_id for v in known if v.rotation is None],
            "rotations_missing",
            "without a rotation, while most have one",
        )
        excluded += [
            ExcludedMeasurement(v.measurement_id, "rotations_missing", _NO_ROTATION)
            for v in known
            if v.rotation is None
        ]
        known = turned
    elif turned:
        warnings.append(
            Advisory(
                "rotations_ignored",
                f"{len(turned)} of {len(known)} measured poses have a rotation; positions alone are used.",
                "Measure rotations at most poses, or identify from those that have one in a session of their own.",
            )
        )
        known = [replace(v, rotation=None) for v in known]
    stated = sum(v.covariance is not None for v in known)
    if 0 < stated < len(known):
        warnings.append(
            Advisory(
                "covariances_ignored",
                f"{stated} of {len(known)} measured poses state a covariance; none is used, and the noise "
                "is read from the residuals.",
                "State the instrument's covariance with each reading, or with none.",
            )
        )
    joint_angles, order = _joint_angles(data, known), measuring_order(data, known)
    poses = PoseData(
        joint_angles,
        positions_of(known),
        rotations_of(known),
        stack_all(v.covariance for v in known),
        labels=tuple(v.pose_id for v in known),
        approach=last_moves(order, joint_angles),
        instrument=True,
    )
    return RobotPoses(poses, (), np.zeros(0, dtype=np.intp), (), order, tuple(excluded), tuple(warnings))


def _check_size(count: int) -> None:
    if count > MAX_POSES:
        raise TooManyMeasurements(
            f"The session holds {count} measurements; one identification takes {MAX_POSES}.",
            "Divide them among several sessions; a few hundred poses that move all joints determine nearly as much.",
        )


def _joint_angles(data: SessionData, poses: Sequence[MeasuredPose]) -> Float[np.ndarray, "n j"]:
    joints = len(data.nominal) if data.nominal is not None else None
    labels = [pose.pose_id for pose in poses]
    return data.model_angles(stack_joint_angles([angles_of(data, pose) for pose in poses], joints, labels))


def shared_errors(poses: Sequence[MeasuredPose]) -> Float[np.ndarray, "n 6 k"] | None:
    """Return the factors of common errors: one lens for each focus group, one scale for each target's print."""
    common = shared_error_columns(poses)[0]
    return common if common.shape[2] else None


def shared_error_columns(
    poses: Sequence[MeasuredPose],
) -> tuple[Float[np.ndarray, "n 6 k"], tuple[str | None, ...]]:
    """Return what `shared_errors` does, and of each column the focus group whose lens it is, None for a print's."""
    names = [pose.image.focus_group if pose.image else "" for pose in poses]
    groups, targets = sorted(set(names)), sorted({pose.frame for pose in poses})
    # Of each group's lens as many as its model has free parameters; the print's scale is the last column.
    factors = max((pose.common.shape[1] - 1 for pose in poses if pose.common is not None), default=0)
    common = np.zeros((len(poses), 6, factors * len(groups) + len(targets)))
    for i, (pose, name) in enumerate(zip(poses, names, strict=True)):
        if pose.common is not None:
            of_lens = pose.common[:, :-1]
            first = factors * groups.index(name)
            common[i, :, first : first + of_lens.shape[1]] = of_lens
            common[i, :, factors * len(groups) + targets.index(pose.frame)] = pose.common[:, -1]
    owners = [*np.repeat(groups, factors).tolist(), *[None] * len(targets)]
    known = np.flatnonzero(np.any(common != 0.0, axis=(0, 1)))
    return np.ascontiguousarray(common[:, :, known]), tuple(owners[k] for k in known)
