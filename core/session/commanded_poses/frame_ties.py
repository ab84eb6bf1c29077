"""Pose accuracy in frames that the session's own commanded poses tie: by whole poses, or by positions.

The target's place in the robot's base and the camera's on the flange are estimated from the commanded poses
themselves (`core.calibration.hand_eye`); what that leaves of each pose's deviation is `core.metrology.accuracy`.
Another instrument is tied in the same way, with the probe in the camera's place. Positions alone (a reflector) are
tied with the roles exchanged: the commanded poses give the orientation of the flange, the readings the position of one
point on it, and the nine unknowns of `core.calibration.hand_eye.position_only` are the instrument in the robot's base
and that point on the flange.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from core.calibration import (
    MIN_POSES_TO_REJECT,
    PositionObservation,
    average_station,
    calibrate_from_positions,
    scale_warnings,
)
from core.errors import Advisory, GridposeError
from core.geometry import invert, so3_log, transform, transform_mean
from core.metrology import (
    CommandedPoint,
    CycleProcess,
    EstimatedDeviation,
    HeldOutDeviation,
    PoseAccuracy,
    TiedDeviations,
    estimate_deviations,
    tied_accuracy,
)
from core.session.commanded_poses.likely_causes import calibrate_or_explain
from core.session.commanded_poses.mean_noise import mean_position_noise, mean_rotation_noise
from core.session.model import CameraMount, CommandedPose, MeasuredPose
from core.session.visits import own_covariances

SAME_ORIENTATION = 1e-5
"""Commanded orientations nearer to one another than this, rad, are one."""

Visits = Mapping[str, Sequence[MeasuredPose]]
Commands = Mapping[str, CommandedPose]
Compared = tuple[dict[str, PoseAccuracy], tuple[Advisory, ...]]
"""AP by pose, and what to know of it."""


def oriented(visits: Sequence[MeasuredPose]) -> bool:
    """Return whether every visit of a pose has an orientation."""
    return all(visit.rotation is not None for visit in visits)


def one_orientation(commands: Commands, within: float = SAME_ORIENTATION) -> bool:
    """Return whether all poses were commanded with one and the same orientation, `within` so many rad."""
    rotations = [R for c in commands.values() if (R := c.rotation()) is not None]
    if len(rotations) < len(commands):
        return False
    return all(float(np.linalg.norm(so3_log(R @ rotations[0].T))) <= within for R in rotations)


def by_whole_poses(
    visits: Visits, commands: Commands, process: CycleProcess | None, mount: CameraMount | None
) -> Compared:
    """Compare oriented poses in frames tied by those that were commanded whole; `process` is what cycles follow,
    `mount` that of the camera, None for another instrument.

    Raises what `core.calibration.hand_eye.calibrate_hand_eye` raises.
    """
    compared = {pose_id: c for pose_id, c in commands.items() if oriented(visits[pose_id])}
    whole = {pose_id: c for pose_id, c in compared.items() if c.rotation() is not None}
    tie = calibrate_or_explain(
        [
            average_station(
                pose_id,
                _commanded_pose(c),
                _transforms(visits[pose_id]),
                own_covariances(visits[pose_id]),
                _mean_common(visits[pose_id]),
            )
            for pose_id, c in whole.items()
        ],
        mount,
    )
    rest = [pose_id for pose_id in compared if pose_id not in whole]
    means = {p: transform_mean(_transforms(visits[p])) for p in rest}
    effects = [tie.effect_of(means[p], _mean_common(visits[p])) for p in rest]
    spread = tie.robot_position_mm**2
    used = np.array([d.used for d in tie.deviations] + [False] * len(rest))
    positions = TiedDeviations(
        np.array(
            [d.position_mm for d in tie.deviations]
            + [tie.frames.attained(means[p][None])[0][:3, 3] - _position(commands[p]) for p in rest]
        ),
        np.array(
            [d.leverage[:3, :3] for d in tie.deviations]
            + [C[:3, :3] / max(spread, 1e-12) for C, _ in effects]
        ),
        np.array([d.common[:3] for d in tie.deviations] + [left[:3] for _, left in effects]),
        used,
        mean_position_noise([visits[p] for p in (*whole, *rest)], process),
    )
    turns = TiedDeviations(
        np.array([d.rotation for d in tie.deviations]),
        np.array([d.leverage[3:, 3:] for d in tie.deviations]),
        np.array([d.common[3:] for d in tie.deviations]),
        used[: len(whole)],
        mean_rotation_noise([visits[p] for p in whole], process),
    )
    places = estimate_deviations(positions)
    point = CommandedPoint(tie.frames.T_base_targets[0][:3, :3], invert(tie.frames.T_flange_camera)[:3, 3])
    found = {}
    for d, place, turn in zip(
        tie.deviations, places, estimate_deviations(turns, lengths=False), strict=False
    ):
        held_out = None
        if d.held_out_position_mm is not None:
            held_out = HeldOutDeviation(d.held_out_position_mm, d.held_out_rotation)
        found[d.pose_id] = tied_accuracy(
            place, turn, whole[d.pose_id].rotation(), held_out, positions.degrees_of_freedom, point
        )
    for pose_id, place in zip(rest, places[len(whole) :], strict=True):
        alone = HeldOutDeviation(place.residual)  # the frames are the others' already
        found[pose_id] = tied_accuracy(place, None, None, alone, positions.degrees_of_freedom, point)
    of_scale = scale_warnings(tie.scale, tie.degrees_of_freedom, instrument=mount is None)
    return {p: one for p, one in found.items() if one is not None}, (*tie.warnings, *of_scale)


def by_positions(visits: Visits, commands: Commands, process: CycleProcess | None) -> Compared:
    """Compare positions, in frames tied by them and by the measured orientations or, without these, the commanded ones.

    `process` is what cycles follow, None for independent ones.

    Raises what `core.calibration.hand_eye.calibrate_from_positions` raises.
    """
    if all(oriented(visits[pose_id]) for pose_id in commands):
        return _by_measured_orientation(visits, commands, process)
    turned = {pose_id: c for pose_id, c in commands.items() if c.rotation() is not None}
    if not MIN_POSES_TO_REJECT <= len(turned) < len(commands):
        return _of_a_point(visits, commands, process)
    try:
        # Where a point on the flange was is not known of the others: they are named.
        return _of_a_point(visits, turned, process)
    except GridposeError:
        return _of_a_point(visits, commands, process)


def _by_measured_orientation(visits: Visits, commands: Commands, process: CycleProcess | None) -> Compared:
    poses = np.array([transform_mean(_transforms(visits[p])) for p in commands])
    turns: list[Float[np.ndarray, "3"]] | None = None
    if one_orientation(commands):
        # The robot's own turns about the one orientation say nothing of where the commanded point is on the flange.
        mean = transform_mean(poses)[:3, :3]
        turns = [so3_log(R @ mean.T) for R in poses[:, :3, :3]]
        poses[:, :3, :3] = mean
    stations = []
    for T, (pose_id, c) in zip(poses, commands.items(), strict=True):
        # Of another instrument only the scatter of the positions themselves is taken.
        common = _mean_common(visits[pose_id])
        covariances = own_covariances(visits[pose_id]) if common is not None else None
        stations.append(
            PositionObservation(
                pose_id,
                _position(c),
                T,
                None if covariances is None else covariances.mean(axis=0),
                common,
            )
        )
    tie = calibrate_from_positions(stations)
    tied = TiedDeviations(
        tie.deviations_mm,
        tie.leverage,
        tie.common,
        tie.used,
        mean_position_noise([visits[p] for p in commands], process),
    )
    point = CommandedPoint(tie.T_base_target[:3, :3], tie.point_camera_mm if turns is None else np.zeros(3))
    rotations: list[EstimatedDeviation] | list[None] = [None] * len(stations)
    if turns is not None:
        rotations = estimate_deviations(
            _about_the_mean(turns, tie.T_base_target[:3, :3], visits, commands, process), lengths=False
        )
    found = {}
    for station, place, turn, held_out in zip(
        stations, estimate_deviations(tied), rotations, tie.held_out_mm, strict=True
    ):
        found[station.pose_id] = tied_accuracy(
            place,
            turn,
            commands[station.pose_id].rotation(),
            None if held_out is None else HeldOutDeviation(held_out),
            tied.degrees_of_freedom,
            point,
        )
    of_images = any(visit.image is not None for pose_id in commands for visit in visits[pose_id])
    of_scale = scale_warnings(tie.scale, tie.degrees_of_freedom, instrument=not of_images)
    return {p: one for p, one in found.items() if one is not None}, (*tie.warnings, *of_scale)


def _about_the_mean(
    turns: Sequence[Float[np.ndarray, "3"]],
    R_base_target: Float[np.ndarray, "3 3"],
    visits: Visits,
    commands: Commands,
    process: CycleProcess | None,
) -> TiedDeviations:
    """Return deviations of orientation from the poses' mean one, which stands for the camera's on the flange."""
    count = len(turns)
    return TiedDeviations(
        np.array(turns) @ R_base_target.T,
        np.broadcast_to(np.eye(3) / count, (count, 3, 3)),
        np.zeros((count, 3, 0)),
        np.ones(count, dtype=np.bool_),
        mean_rotation_noise([visits[p] for p in commands], process),
    )


def _of_a_point(visits: Visits, commands: Commands, process: CycleProcess | None) -> Compared:
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
            _commanded_pose(c) if known else transform(np.eye(3), _position(c)),
        )
        for pose_id, c in commands.items()
    ]
    tie = calibrate_from_positions(stations)
    R_base_instrument = tie.T_base_target[:3, :3].T
    # What the tie calls attained is here what was commanded, seen by the instrument.
    tied = TiedDeviations(
        -tie.deviations_mm @ R_base_instrument.T,
        R_base_instrument @ tie.leverage @ R_base_instrument.T,
        np.zeros((len(stations), 3, 0)),
        tie.used,
        mean_position_noise([visits[p] for p in commands], process),
    )
    found = {}
    for station, place, held_out in zip(stations, estimate_deviations(tied), tie.held_out_mm, strict=True):
        found[station.pose_id] = tied_accuracy(
            place,
            None,
            None,
            None if held_out is None else HeldOutDeviation(-R_base_instrument @ held_out),
            tied.degrees_of_freedom,
            CommandedPoint(R_base_instrument, np.zeros(3)),
        )
    scale = None if tie.scale is None else tie.scale.inverse
    warnings += [*tie.warnings, *scale_warnings(scale, tie.degrees_of_freedom, instrument=True)]
    return {p: one for p, one in found.items() if one is not None}, tuple(warnings)


def _commanded_pose(commanded: CommandedPose) -> Float[np.ndarray, "4 4"]:
    """Return T_base_flange as commanded; unturned where the orientation is not known."""
    rotation = commanded.rotation()
    return transform(np.eye(3) if rotation is None else rotation, _position(commanded))


def _position(commanded: CommandedPose) -> Float[np.ndarray, "3"]:
    return np.array(commanded.position_mm, dtype=np.float64)


def _transforms(visits: Sequence[MeasuredPose]) -> Float[np.ndarray, "n 4 4"]:
    return np.array([transform(v.rotation, v.position_mm) for v in visits if v.rotation is not None])


def _mean_common(visits: Sequence[MeasuredPose]) -> Float[np.ndarray, "6 e"] | None:
    common = [visit.common for visit in visits if visit.common is not None]
    return np.mean(common, axis=0) if len(common) == len(visits) else None
