"""Poses of one command, such as a pose that is approached from several sides under several ids.

What the robot is off belongs to the command, and ids of one command share it. Taken as independent, they would count it
as often as there are ids: degrees of freedom too many, intervals too short, and no pose held out of what its twins
tie. So they tie the frames as one station, the mean of their visits, whose covariance does not shrink by them. Each id
then differs from its station by what was measured.

A pose_id that belongs to another command is no twin: ids of one command whose means lie apart are stations of their
own, and the one that does not fit is rejected by itself. So are ids whose joint angles are of another configuration.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from core.calibration import (
    HandEyeCalibration,
    HandEyeObservation,
    PoseResidual,
    PositionObservation,
    PositionOnlyCalibration,
)
from core.geometry import so3_log, transform
from core.metrology import MeanNoise, PosesOfStations, TiedDeviations
from core.session.commanded_poses.pose_arrays import Commands, Visits, mean_position
from core.session.model import CommandedPose, MeasuredPose

MAX_APART, MAX_TURN = 0.02, math.radians(2.0)
"""Of the extent of all poses, and in rad: ids of one command that differ by more were not measured at one pose. A wrong
pose_id is off by about the extent, and how a pose is approached matters by some hundredths of a millimetre."""
MAX_JOINTS_APART_DEG = 5.0
"""Of joint angles stated for one pose of the flange: from there on it is reached in another configuration, in which the
robot is off by something else."""

K = TypeVar("K", bound=Hashable)
TiedStation = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"], Float[np.ndarray, "3 k"], bool]
"""Deviation, leverage, common errors, and whether the station tied the frames."""
TiedPose = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 k"]]
"""Deviation and common errors."""


def command_key(pose: CommandedPose) -> Hashable:
    """Return a key that is equal for poses with the same command; None where no command is known."""
    if pose.position_mm is not None:
        angles = [None if a is None else round(a, 6) for a in (pose.roll_deg, pose.pitch_deg, pose.yaw_deg)]
        rotation = CommandedPose(None, angles[0], angles[1], angles[2]).rotation()
        if rotation is None:
            return (*_rounded(pose.position_mm), *angles)
        return pose_key(transform(rotation, np.array(pose.position_mm, dtype=np.float64)))
    return None if pose.joint_angles_deg is None else ("joints", *_rounded(pose.joint_angles_deg))


def pose_key(T: Float[np.ndarray, "4 4"]) -> Hashable:
    """Return a key that is equal for equal poses (mm), however their orientation was stated."""
    return (*_rounded(T[:3, 3].tolist()), *np.round(T[:3, :3].ravel(), 8).tolist())


def distinct_commands(commands: Commands) -> int:
    """Return how many commands the poses have; one whose command is not known has its own."""
    keys = {pose_id: command_key(c) for pose_id, c in commands.items()}
    return len({pose_id if key is None else key for pose_id, key in keys.items()})


def stations_of(
    keys: Mapping[K, Hashable],
    commands: Mapping[K, CommandedPose],
    visits: Mapping[K, Sequence[MeasuredPose]],
) -> list[tuple[K, ...]]:
    """Return the poses of each station, in the order of their first poses; `keys` are equal for equal commands."""
    groups: dict[Hashable, list[list[K]]] = {}
    stations: list[list[K]] = []
    limit = (
        MAX_APART * _extent([visits[pose] for pose in keys]) if len(set(keys.values())) < len(keys) else 0.0
    )
    for pose, key in keys.items():
        of_command = groups.setdefault(key, [])
        for station in of_command:
            first = station[0]
            if _one_configuration(commands[first], commands[pose]) and _together(
                visits[first], visits[pose], limit
            ):
                station.append(pose)
                break
        else:
            of_command.append([pose])
            stations.append(of_command[-1])
    return [tuple(station) for station in stations]


def all_visits(station: Sequence[K], visits: Mapping[K, Sequence[MeasuredPose]]) -> list[MeasuredPose]:
    """Return the visits of a station's poses."""
    return [visit for pose in station for visit in visits[pose]]


def name_of(station: Sequence[str]) -> str:
    """Return what messages call a station."""
    return ", ".join(station)


def tied_deviations(
    stations: Sequence[Sequence[str]],
    visits: Visits,
    noise: MeanNoise,
    of_stations: Sequence[TiedStation],
    of_poses: Sequence[TiedPose],
) -> TiedDeviations:
    """Return the deviations of stations and of their poses; `visits`, `noise` and `of_poses` have one order."""
    residuals, leverage, common, used = (np.array(part) for part in zip(*of_stations, strict=True))
    deviations, of_shared = (np.array(part) for part in zip(*of_poses, strict=True))
    place = {pose_id: i for i, station in enumerate(stations) for pose_id in station}
    station = np.array([place[pose_id] for pose_id in visits], dtype=np.intp)
    counts = np.array([len(of_pose) for of_pose in visits.values()])
    weight = counts / np.bincount(station, counts)[station]
    each = PosesOfStations(station, deviations - residuals[station], of_shared, noise, weight)
    return TiedDeviations(residuals, leverage, common, used, each.noise_of_stations, each)


def deviation_in_frames(
    tie: HandEyeCalibration, residual: PoseResidual, station: HandEyeObservation, pose: HandEyeObservation
) -> PoseResidual:
    """Return the deviation of one pose of a station whose `residual` is known; held out, all its twins are, too."""
    if station.pose_id == pose.pose_id:
        return residual
    attained = tie.frames.attained(pose.T_target_camera[None], pose.target)[0]
    position = attained[:3, 3] - pose.T_base_flange[:3, 3]
    rotation = so3_log(attained[:3, :3] @ pose.T_base_flange[:3, :3].T)
    apart, turned = position - residual.position_mm, rotation - residual.rotation
    held_out, held_out_turn = residual.held_out_position_mm, residual.held_out_rotation
    common = residual.common
    if pose.common is not None and station.common is not None:
        effect = tie.measurement_effect(station.T_target_camera, station.target)
        common = common + effect @ (pose.common - station.common)
    return PoseResidual(
        pose.pose_id,
        position,
        rotation,
        None if held_out is None else held_out + apart,
        None if held_out_turn is None else held_out_turn + turned,
        residual.used,
        residual.leverage,
        common,
    )


def position_in_frames(
    tie: PositionOnlyCalibration, i: int, station: PositionObservation, pose: PositionObservation
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 k"], Float[np.ndarray, "3"] | None]:
    """Return the deviation of one pose of the i-th station, its common errors, and the deviation held out as in
    `deviation_in_frames`.
    """
    residual, common, held_out = tie.deviations_mm[i], tie.common[i], tie.held_out_mm[i]
    if station.pose_id == pose.pose_id:
        return residual, common, held_out
    deviation = tie.attained(pose.T_target_camera[None])[0] - pose.position_base_mm
    if pose.common is not None and station.common is not None:
        common = common + tie.measurement_effect(station.T_target_camera) @ (pose.common - station.common)
    return deviation, common, None if held_out is None else held_out + (deviation - residual)


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(value, 6) for value in values]


def _extent(visits: Sequence[Sequence[MeasuredPose]]) -> float:
    """Return the root mean square distance of the poses from their centre, mm."""
    places = np.array([mean_position(of_pose) for of_pose in visits])
    return float(np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1))))


def _one_configuration(one: CommandedPose, other: CommandedPose) -> bool:
    """Return whether no joint angles contradict that one pose of the flange is one of the joints, too."""
    q, r = one.joint_angles_deg, other.joint_angles_deg
    if q is None or r is None or len(q) != len(r):
        return True
    return max((abs(a - b) for a, b in zip(q, r, strict=True)), default=0.0) <= MAX_JOINTS_APART_DEG


def _together(one: Sequence[MeasuredPose], other: Sequence[MeasuredPose], limit_mm: float) -> bool:
    if float(np.linalg.norm(mean_position(one) - mean_position(other))) > limit_mm:
        return False
    R, S = one[0].rotation, other[0].rotation
    return R is None or S is None or float(np.linalg.norm(so3_log(R @ S.T))) <= MAX_TURN
