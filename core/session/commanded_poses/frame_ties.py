"""Pose accuracy in frames that the session's own commanded poses tie: by whole poses, or by positions.

The target's place in the robot's base and the camera's on the flange are estimated from the commanded poses
themselves (`core.calibration.hand_eye`); what that leaves of each pose's deviation is `core.metrology.accuracy`.
Another instrument is tied in the same way, with the probe in the camera's place. Positions alone (a reflector) are
tied with the roles exchanged: the commanded poses give the orientation of the flange, the readings the position of one
point on it, and the nine unknowns of `core.calibration.hand_eye.position_only` are the instrument in the robot's base
and that point on the flange (`.position_ties`).
"""

from __future__ import annotations

from collections.abc import Sequence

from core.calibration import (
    MIN_POSES_TO_REJECT,
    HandEyeCalibration,
    HandEyeObservation,
    average_station,
    scale_warnings,
)
from core.errors import GridposeError
from core.geometry import invert, transform_mean
from core.metrology import CommandedPoint, CycleProcess, HeldOutDeviation, estimate_deviations, tied_accuracy
from core.session.commanded_poses.equal_commands import (
    TiedStation,
    all_visits,
    command_key,
    deviation_in_frames,
    distinct_commands,
    name_of,
    stations_of,
    tied_deviations,
)
from core.session.commanded_poses.likely_causes import calibrate_or_explain
from core.session.commanded_poses.mean_noise import mean_position_noise, mean_rotation_noise
from core.session.commanded_poses.pose_arrays import (
    Commands,
    Compared,
    Visits,
    commanded_pose,
    commanded_position,
    mean_common,
    oriented,
    transforms_of,
)
from core.session.commanded_poses.position_ties import by_measured_orientation, of_a_point
from core.session.model import CameraMount, CommandedPose, MeasuredPose
from core.session.visits import own_covariances


def by_whole_poses(
    visits: Visits, commands: Commands, process: CycleProcess | None, mount: CameraMount | None
) -> Compared:
    """Compare oriented poses in frames tied by those that were commanded whole; `process` is what cycles follow,
    `mount` that of the camera, None for another instrument.

    Raises what `core.calibration.hand_eye.calibrate_hand_eye` raises.
    """
    compared = {pose_id: c for pose_id, c in commands.items() if oriented(visits[pose_id])}
    whole = {pose_id: c for pose_id, c in compared.items() if c.rotation() is not None}
    stations = stations_of({p: command_key(c) for p, c in whole.items()}, whole, visits)
    tying = [_observation(station, whole, visits) for station in stations]
    tie = calibrate_or_explain(tying, mount)
    by_pose = {
        p: deviation_in_frames(tie, residual, tied, _observation((p,), whole, visits))
        for station, tied, residual in zip(stations, tying, tie.deviations, strict=True)
        for p in station
    }
    of_poses = [by_pose[p] for p in whole]
    turns = tied_deviations(
        stations,
        {p: visits[p] for p in whole},
        mean_rotation_noise([visits[p] for p in whole], process),
        [(d.rotation, d.leverage[3:, 3:], d.common[3:], d.used) for d in tie.deviations],
        [(d.rotation, d.common[3:]) for d in of_poses],
    )
    rest = [pose_id for pose_id in compared if pose_id not in whole]
    order = (*whole, *rest)
    alone = [_in_frames_of_others(tie, visits[p], commands[p]) for p in rest]
    positions = tied_deviations(
        [*stations, *((p,) for p in rest)],
        {p: visits[p] for p in order},
        mean_position_noise([visits[p] for p in order], process),
        [(d.position_mm, d.leverage[:3, :3], d.common[:3], d.used) for d in tie.deviations] + alone,
        [(d.position_mm, d.common[:3]) for d in of_poses] + [(off, left) for off, _, left, _ in alone],
    )
    places = estimate_deviations(positions)
    point = CommandedPoint(tie.frames.T_base_targets[0][:3, :3], invert(tie.frames.T_flange_camera)[:3, 3])
    found = {}
    for d, place, turn in zip(of_poses, places, estimate_deviations(turns, lengths=False), strict=False):
        held_out = None
        if d.held_out_position_mm is not None:
            held_out = HeldOutDeviation(d.held_out_position_mm, d.held_out_rotation)
        found[d.pose_id] = tied_accuracy(
            place, turn, whole[d.pose_id].rotation(), held_out, positions.degrees_of_freedom, point
        )
    for pose_id, place in zip(rest, places[len(whole) :], strict=True):
        by_others = HeldOutDeviation(place.residual)  # the frames are the others' already
        found[pose_id] = tied_accuracy(place, None, None, by_others, positions.degrees_of_freedom, point)
    of_scale = scale_warnings(tie.scale, tie.degrees_of_freedom, instrument=mount is None)
    return {p: one for p, one in found.items() if one is not None}, (*tie.warnings, *of_scale)


def _observation(station: Sequence[str], commands: Commands, visits: Visits) -> HandEyeObservation:
    """Return the mean of the visits of one pose, or of several of one command."""
    of_station = all_visits(station, visits)
    return average_station(
        name_of(station),
        commanded_pose(commands[station[0]]),
        transforms_of(of_station),
        own_covariances(of_station),
        mean_common(of_station),
    )


def _in_frames_of_others(
    tie: HandEyeCalibration, visits: Sequence[MeasuredPose], commanded: CommandedPose
) -> TiedStation:
    """Return the deviation of position of a pose that tied no frames, as of a station."""
    mean = transform_mean(transforms_of(visits))
    C, left = tie.effect_of(mean, mean_common(visits))
    off = tie.frames.attained(mean[None])[0][:3, 3] - commanded_position(commanded)
    return off, C[:3, :3] / max(tie.robot_position_mm**2, 1e-12), left[:3], False


def by_positions(visits: Visits, commands: Commands, process: CycleProcess | None) -> Compared:
    """Compare positions, in frames tied by them and by the measured orientations or, without these, the commanded ones.

    `process` is what cycles follow, None for independent ones.

    Raises what `core.calibration.hand_eye.calibrate_from_positions` raises.
    """
    if all(oriented(visits[pose_id]) for pose_id in commands):
        return by_measured_orientation(visits, commands, process)
    turned = {pose_id: c for pose_id, c in commands.items() if c.rotation() is not None}
    if distinct_commands(turned) < MIN_POSES_TO_REJECT or len(turned) == len(commands):
        return of_a_point(visits, commands, process)
    try:
        # Where a point on the flange was is not known of the others: they are named.
        return of_a_point(visits, turned, process)
    except GridposeError:
        return of_a_point(visits, commands, process)
