"""Pose accuracy in frames that the session's own commanded poses tie: by whole poses, or by positions.

The target's place in the robot's base and the camera's on the flange are estimated from the commanded poses
themselves (`core.calibration.hand_eye`), so that each pose is compared in frames tied by all the
others. Another instrument is tied in the same way, with the probe in the camera's place. Positions alone (a
reflector) are tied with the roles exchanged: the commanded poses give the orientation of the flange, the
readings the position of one point on it, and the nine unknowns of `core.calibration.hand_eye.position_only`
are the instrument in the robot's base and that point on the flange.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from core.calibration import (
    MIN_POSES_TO_REJECT,
    PoseResidual,
    PositionObservation,
    average_station,
    calibrate_from_positions,
    calibrate_hand_eye,
)
from core.errors import Advisory, GridposeError
from core.geometry import so3_exp, transform, transform_mean
from core.metrology import PerComponent, pose_accuracy
from core.session.model import CommandedPose, MeasuredPose

Visits = Mapping[str, Sequence[MeasuredPose]]
Commands = Mapping[str, CommandedPose]
Compared = tuple[dict[str, PerComponent[float | None]], tuple[Advisory, ...]]
"""AP by pose (mm, rad), and what to know of it."""


def oriented(visits: Sequence[MeasuredPose]) -> bool:
    """Return whether every visit of a pose has an orientation."""
    return all(visit.rotation is not None for visit in visits)


def by_whole_poses(visits: Visits, commands: Commands) -> Compared:
    """Compare oriented poses in frames tied by those that were commanded whole.

    Raises what `core.calibration.hand_eye.calibrate_hand_eye` raises.
    """
    compared = {pose_id: c for pose_id, c in commands.items() if oriented(visits[pose_id])}
    whole = {pose_id: c for pose_id, c in compared.items() if c.rotation() is not None}
    tie = calibrate_hand_eye(
        [
            average_station(
                pose_id,
                _commanded_pose(c),
                _transforms(visits[pose_id]),
                _own_covariances(visits[pose_id]),
                _mean_common(visits[pose_id]),
            )
            for pose_id, c in whole.items()
        ]
    )
    found = {d.pose_id: _accuracy_of(d, _commanded_pose(commands[d.pose_id])) for d in tie.deviations}
    for pose_id, c in compared.items():
        if pose_id not in whole:
            attained = tie.frames.attained(transform_mean(_transforms(visits[pose_id]))[None])[0]
            found[pose_id] = pose_accuracy(attained[:3, 3], np.array(c.position_mm, dtype=np.float64))
    return found, tie.warnings


def by_positions(visits: Visits, commands: Commands) -> Compared:
    """Compare positions, in frames tied by them and by the measured orientations or, without these, the commanded ones.

    Raises what `core.calibration.hand_eye.calibrate_from_positions` raises.
    """
    if all(oriented(visits[pose_id]) for pose_id in commands):
        return _by_measured_orientation(visits, commands)
    turned = {pose_id: c for pose_id, c in commands.items() if c.rotation() is not None}
    if not MIN_POSES_TO_REJECT <= len(turned) < len(commands):
        return _of_a_point(visits, commands)
    try:
        # Where a point on the flange was is not known of the others: they are named.
        return _of_a_point(visits, turned)
    except GridposeError:
        return _of_a_point(visits, commands)


def _by_measured_orientation(visits: Visits, commands: Commands) -> Compared:
    stations = []
    for pose_id, c in commands.items():
        # Of another instrument only the scatter of the positions themselves is taken.
        covariances = _own_covariances(visits[pose_id]) if _mean_common(visits[pose_id]) is not None else None
        stations.append(
            PositionObservation(
                pose_id,
                np.array(c.position_mm, dtype=np.float64),
                transform_mean(_transforms(visits[pose_id])),
                None if covariances is None else covariances.mean(axis=0),
            )
        )
    tie = calibrate_from_positions(stations)
    found = {}
    for station, fitted, held_out in zip(stations, tie.deviations_mm, tie.held_out_mm, strict=True):
        attained = station.position_base_mm + (fitted if held_out is None else held_out)
        found[station.pose_id] = pose_accuracy(attained, station.position_base_mm)
    return found, tie.warnings


def _of_a_point(visits: Visits, commands: Commands) -> Compared:
    """Tie with the roles exchanged: the readings are the places, the commanded poses turn the point."""
    known = all(c.rotation() is not None for c in commands.values())
    warnings: list[Advisory] = []
    if not known:
        warnings.append(
            Advisory(
                "tool_offset_unknown",
                "Neither were orientations commanded for every pose, nor do all readings have one: accuracy assumes "
                "that the measured point is the commanded one, or that all poses have the same orientation.",
                "State the poses' commanded orientations.",
            )
        )
    stations = [
        PositionObservation(
            pose_id,
            np.mean([visit.position_mm for visit in visits[pose_id]], axis=0),
            _commanded_pose(c) if known else transform(np.eye(3), np.array(c.position_mm, dtype=np.float64)),
        )
        for pose_id, c in commands.items()
    ]
    tie = calibrate_from_positions(stations)
    R_base_instrument = tie.T_base_target[:3, :3].T
    found = {}
    for station, fitted, held_out in zip(stations, tie.deviations_mm, tie.held_out_mm, strict=True):
        # What the tie calls attained is here what was commanded, seen by the instrument.
        deviation = -R_base_instrument @ (fitted if held_out is None else held_out)
        commanded = station.T_target_camera[:3, 3]
        found[station.pose_id] = pose_accuracy(commanded + deviation, commanded)
    return found, (*warnings, *tie.warnings)


def _commanded_pose(commanded: CommandedPose) -> Float[np.ndarray, "4 4"]:
    """Return T_base_flange as commanded; unturned where the orientation is not known."""
    rotation = commanded.rotation()
    return transform(
        np.eye(3) if rotation is None else rotation, np.array(commanded.position_mm, dtype=np.float64)
    )


def _transforms(visits: Sequence[MeasuredPose]) -> Float[np.ndarray, "n 4 4"]:
    return np.array([transform(v.rotation, v.position_mm) for v in visits if v.rotation is not None])


def _own_covariances(visits: Sequence[MeasuredPose]) -> Float[np.ndarray, "n 6 6"] | None:
    covariances = [own for visit in visits if (own := visit.own_covariance()) is not None]
    return np.array(covariances) if len(covariances) == len(visits) else None


def _mean_common(visits: Sequence[MeasuredPose]) -> Float[np.ndarray, "6 e"] | None:
    common = [visit.common for visit in visits if visit.common is not None]
    return np.mean(common, axis=0) if len(common) == len(visits) else None


def _accuracy_of(deviation: PoseResidual, commanded: Float[np.ndarray, "4 4"]) -> PerComponent[float | None]:
    """Return AP by the frames that the other poses tie, where they suffice for that."""
    position, turn = deviation.held_out_position_mm, deviation.held_out_rotation
    if position is None or turn is None:
        position, turn = deviation.position_mm, deviation.rotation
    return pose_accuracy(
        commanded[:3, 3] + position, commanded[:3, 3], so3_exp(turn) @ commanded[:3, :3], commanded[:3, :3]
    )
