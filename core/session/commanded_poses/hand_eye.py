"""The camera on the robot's flange and the targets in its base, from a session's commanded poses; or a fixed camera in
the base, and the target on the flange.

Each command is a station before each target that its images show: the mean of its visits, before a print that may
depart from its nominal grid (`core.session.absolute_poses`). Poses of one command are one station before a target
(`.equal_commands`), and each has its own deviation from it. What the lens and the prints do to all of them is carried
through as common to all.

The stations of one command share the robot's deviation, which the fit takes as independent. Its covariance is
multiplied by the mean number of stations a command has: that is exact where every one is seen before as many targets
and the robot's deviation is all there is, and too large otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.calibration import (
    HandEyeCalibration,
    HandEyeObservation,
    PoseResidual,
    average_station,
    scale_warnings,
)
from core.errors import Advisory, CommandedPosesMissing
from core.geometry import transform
from core.kinematics import forward
from core.session.absolute_poses import absolute_poses, stacked_errors
from core.session.camera_mount import check_one_on_flange, moving_poses
from core.session.commanded_poses.equal_commands import (
    deviation_in_frames,
    name_of,
    pose_key,
    stations_of,
)
from core.session.commanded_poses.likely_causes import calibrate_or_explain
from core.session.estimate import ExcludedMeasurement, ExcludedPose, SessionEstimate
from core.session.frame_warnings import gimbal_warnings
from core.session.model import CameraMount, CommandedPose, MeasuredPose, SessionData, natural
from core.session.robot import shared_errors
from core.session.visits import own_covariances

WEAK_SHARE = 0.005
"""Standard uncertainty of the camera on the flange, of the working distance and in rad, from which on a warning says
that the motion hardly determines it."""
_UNKNOWN = "Its commanded pose is not known whole."


@dataclass(frozen=True, slots=True)
class HandEyeStation:
    """One commanded pose before one target: the place of the target in the session's list, the number of visits that
    are averaged, and the deviations attained - commanded.
    """

    pose_id: str
    target: int
    visits: int
    deviation: PoseResidual


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Root mean squares of distances (mm) and of angles (rad) over `poses` stations."""

    poses: int
    position_rms_mm: float
    rotation_rms: float


@dataclass(frozen=True)
class SessionHandEye:
    """T_flange_camera and a T_base_target for each of `targets`, the places in the session's list.

    With the camera fixed (`camera_mount`) the calibration has T_flange_target in the place of T_flange_camera, and
    T_base_camera in that of the only T_base_target; `targets` then names the target on the flange.

    `covariance` is of T_flange_camera and each T_base_target in turn, of each x, y, z (mm), then a small rotation w
    (rad) with R_true = exp(w) R. `residual` is of the deviations as fitted,
    `validation` of each station's with the frames from all other stations; None where these do not suffice.
    `working_distance_mm` is the median distance of the camera from its target.
    """

    camera_mount: CameraMount
    calibration: HandEyeCalibration
    covariance: Float[np.ndarray, "p p"]
    targets: tuple[int, ...]
    stations: tuple[HandEyeStation, ...]
    residual: HeldOut
    validation: HeldOut | None
    working_distance_mm: float
    excluded: tuple[ExcludedPose, ...]
    excluded_measurements: tuple[ExcludedMeasurement, ...]
    warnings: tuple[Advisory, ...]


def calibrate_session_hand_eye(
    data: SessionData, estimate: SessionEstimate, *, nominal_prints: bool = False
) -> SessionHandEye:
    """Estimate where the camera sits on the flange and each target lies in the robot's base; of a fixed camera, where
    the target sits on the flange and the camera lies in the base.

    Parameters
    ----------
    data
        The session. Commanded poses count that state position and orientation; where none does, the nominal robot's
        flange at the commanded joint angles takes their place.
    estimate
        The session's cameras and poses. Images that show another orientation than the first of their pose are excluded.
    nominal_prints
        Whether the prints are taken as their nominal grids, as plans of further views do.

    Raises CommandedPosesMissing, SeveralTargetsOnFlange, and what `core.calibration.calibrate_hand_eye` raises where
    the poses do not determine the frames.
    """
    commanded, warnings = _commanded(data)
    counted: Sequence[MeasuredPose] = [
        pose for pose in estimate.poses if pose.measurement_id not in estimate.unclear
    ]
    if not nominal_prints:
        absolute = absolute_poses(data, estimate)
        counted = [absolute.poses[pose.measurement_id] for pose in counted]
        warnings = (*absolute.warnings, *warnings)
    visits: dict[tuple[str, int], list[int]] = {}
    for i, pose in enumerate(counted):
        visits.setdefault((pose.pose_id, pose.frame), []).append(i)
    stations = sorted(
        (key for key in visits if key[0] in commanded), key=lambda key: (natural(key[0]), key[1])
    )
    if not stations:
        raise CommandedPosesMissing(
            f"None of the {len({key[0] for key in visits})} poses with usable images has a commanded pose."
        )
    targets = tuple(sorted({target for _, target in stations}))
    check_one_on_flange(data, [counted[i] for key in stations for i in visits[key]])
    counted = moving_poses(data, counted)
    common = shared_errors(counted) if nominal_prints else stacked_errors(counted)

    def observation(station: Sequence[tuple[str, int]]) -> HandEyeObservation:
        seen = [i for key in station for i in visits[key]]
        pose_id, target = station[0]
        return average_station(
            name_of([pose_id for pose_id, _ in station]),
            commanded[pose_id],
            np.array([_transform(counted[i]) for i in seen]),
            own_covariances([counted[i] for i in seen]),
            None if common is None else common[seen].mean(axis=0),
            targets.index(target),
        )

    commands = {pose_id: pose_key(commanded[pose_id]) for pose_id, _ in stations}
    merged = stations_of(
        {(pose_id, target): (target, commands[pose_id]) for pose_id, target in stations},
        {key: data.commanded[key[0]] for key in stations},
        {key: [counted[i] for i in visits[key]] for key in stations},
    )
    tying = [observation(station) for station in merged]
    tie = calibrate_or_explain(tying, data.camera_mount)
    deviations = {
        key: deviation_in_frames(tie, residual, tied, observation([key]))
        for station, tied, residual in zip(merged, tying, tie.deviations, strict=True)
        for key in station
    }
    per_command = len(merged) / len(set(commands.values()))
    covariance = tie.covariance + (per_command - 1.0) * tie.covariance_given_camera
    scale = tie.scale
    if scale is not None:  # its uncertainty, too, is of stations that share the robot's deviation
        scale = replace(scale, standard_uncertainty=math.sqrt(per_command) * scale.standard_uncertainty)
        tie = replace(tie, scale=scale)
    distance = float(
        np.median([np.linalg.norm(counted[i].position_mm) for key in stations for i in visits[key]])
    )
    found = tuple(
        HandEyeStation(pose_id, target, len(visits[pose_id, target]), deviations[pose_id, target])
        for pose_id, target in stations
    )
    used = [station.deviation for station in found if station.deviation.used]
    return SessionHandEye(
        data.camera_mount,
        tie,
        covariance,
        targets,
        found,
        _rms([(d.position_mm, d.rotation) for d in used]),
        _held_out(used),
        distance,
        _excluded(visits, commanded),
        (
            *estimate.excluded.values(),
            *estimate.unclear.values(),
            *(
                ExcludedMeasurement(pose.measurement_id, "commanded_pose_missing", _UNKNOWN)
                for pose in counted
                if pose.pose_id not in commanded
            ),
        ),
        (
            *estimate.warnings,
            *warnings,
            *tie.warnings,
            *scale_warnings(scale, tie.degrees_of_freedom),
            *_weak(covariance, distance, data.camera_mount),
            *gimbal_warnings(tie.T_flange_camera, list(tie.T_base_targets), data.camera_mount),
        ),
    )


def _commanded(data: SessionData) -> tuple[dict[str, Float[np.ndarray, "4 4"]], tuple[Advisory, ...]]:
    """Return T_base_flange as commanded by pose: as stated, or else by the nominal robot and the joint angles."""
    stated = {
        pose_id: transform(rotation, np.array(c.position_mm, dtype=np.float64))
        for pose_id, c in data.commanded.items()
        if c.position_mm is not None and (rotation := c.rotation()) is not None
    }
    if stated or data.nominal is None:
        return stated, ()
    by_joints: dict[str, CommandedPose] = {
        pose_id: c
        for pose_id, c in data.commanded.items()
        if c.joint_angles_deg is not None and len(c.joint_angles_deg) == len(data.nominal)
    }
    if not by_joints:
        return {}, ()
    q = data.model_angles(np.array([c.joint_angles_deg for c in by_joints.values()], dtype=np.float64))
    warning = Advisory(
        "commanded_by_nominal_robot",
        "No pose states position and orientation: the flange is where the nominal robot has it at the commanded joint "
        "angles, and the robot's errors are in the frames.",
        "State the commanded poses, or identify the robot (dh).",
    )
    return dict(zip(by_joints, forward(data.nominal, q), strict=True)), (warning,)


def _transform(pose: MeasuredPose) -> Float[np.ndarray, "4 4"]:
    assert pose.rotation is not None  # poses of images always have one
    return transform(pose.rotation, pose.position_mm)


def _held_out(used: Sequence[PoseResidual]) -> HeldOut | None:
    known = [
        (d.held_out_position_mm, d.held_out_rotation)
        for d in used
        if d.held_out_position_mm is not None and d.held_out_rotation is not None
    ]
    return _rms(known) if known else None


def _rms(deviations: Sequence[tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]]) -> HeldOut:
    position, rotation = (
        math.sqrt(float(np.mean([np.sum(d[k] ** 2) for d in deviations]))) for k in range(2)
    )
    return HeldOut(len(deviations), position, rotation)


def _excluded(
    visits: Mapping[tuple[str, int], Sequence[int]],
    commanded: Mapping[str, Float[np.ndarray, "4 4"]],
) -> tuple[ExcludedPose, ...]:
    """Return the poses that do not count, and why."""
    seen = {pose_id for pose_id, _ in visits}
    found = [
        *(ExcludedPose(pose_id, "commanded_pose_missing", _UNKNOWN) for pose_id in seen - set(commanded)),
        *(
            ExcludedPose(pose_id, "no_usable_images", "No image of it counts.")
            for pose_id in set(commanded) - seen
        ),
    ]
    return tuple(sorted(found, key=lambda one: natural(one.pose_id)))


def _weak(
    covariance: Float[np.ndarray, "p p"], distance_mm: float, mount: CameraMount
) -> tuple[Advisory, ...]:
    """Warn where the motion hardly determines what is on the flange."""
    values, vectors = np.linalg.eigh(covariance[:3, :3])
    worst, turn = (
        math.sqrt(max(float(v), 0.0)) for v in (values[-1], np.linalg.eigvalsh(covariance[3:6, 3:6])[-1])
    )
    if worst <= WEAK_SHARE * distance_mm and turn <= WEAK_SHARE:
        return ()
    axis = ", ".join(f"{value:.2f}" for value in vectors[:, -1])
    return (
        Advisory(
            "motion_weak",
            f"The poses hardly determine where the {'camera' if mount == 'robot' else 'target'} sits on the flange: "
            f"standard uncertainty {worst:.2g} mm "
            f"along ({axis}) of the flange, {math.degrees(turn):.2g}° in rotation.",
            "Add poses whose orientations differ by 20° or more about at least two different axes.",
        ),
    )
