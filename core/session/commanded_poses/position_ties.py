"""Pose accuracy in frames tied by positions: with the measured orientations, or as those of a point on the flange."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from core.calibration import PositionObservation, calibrate_from_positions, scale_warnings
from core.errors import Advisory
from core.geometry import so3_log, transform, transform_mean
from core.metrology import (
    CommandedPoint,
    CycleProcess,
    EstimatedDeviation,
    HeldOutDeviation,
    TiedDeviations,
    estimate_deviations,
    tied_accuracy,
)
from core.session.commanded_poses.equal_commands import (
    all_visits,
    command_key,
    name_of,
    position_in_frames,
    stations_of,
    tied_deviations,
)
from core.session.commanded_poses.mean_noise import mean_position_noise, mean_rotation_noise
from core.session.commanded_poses.pose_arrays import (
    Commands,
    Compared,
    Visits,
    commanded_pose,
    commanded_position,
    mean_common,
    mean_position,
    one_orientation,
    transforms_of,
)
from core.session.visits import own_covariances


def by_measured_orientation(visits: Visits, commands: Commands, process: CycleProcess | None) -> Compared:
    """Compare the positions of poses that were measured with their orientations."""
    stations = stations_of({p: command_key(c) for p, c in commands.items()}, commands, visits)
    of_stations = _mean_poses(stations, visits)
    of_poses = _mean_poses([(p,) for p in commands], visits)
    turns: list[Float[np.ndarray, "_ 3"]] | None = None
    if one_orientation(commands):
        # The robot's own turns about the one orientation say nothing of where the commanded point is on the flange.
        mean = transform_mean(of_stations)[:3, :3]
        turns = [np.array([so3_log(R @ mean.T) for R in T[:, :3, :3]]) for T in (of_stations, of_poses)]
        of_stations[:, :3, :3] = of_poses[:, :3, :3] = mean
    observed = [
        _observation(station, T, commands, visits) for station, T in zip(stations, of_stations, strict=True)
    ]
    tie = calibrate_from_positions(observed)
    place = {p: i for i, station in enumerate(stations) for p in station}
    deviations = [
        position_in_frames(tie, place[p], observed[place[p]], _observation((p,), T, commands, visits))
        for p, T in zip(commands, of_poses, strict=True)
    ]
    chosen = {p: visits[p] for p in commands}
    tied = tied_deviations(
        stations,
        chosen,
        mean_position_noise(list(chosen.values()), process),
        list(zip(tie.deviations_mm, tie.leverage, tie.common, tie.used.tolist(), strict=True)),
        [(off, common) for off, common, _ in deviations],
    )
    R_base_target = tie.T_base_target[:3, :3]
    point = CommandedPoint(R_base_target, tie.point_camera_mm if turns is None else np.zeros(3))
    rotations: list[EstimatedDeviation] | list[None] = [None] * len(commands)
    if turns is not None:
        rotations = estimate_deviations(
            _about_the_mean(stations, chosen, [t @ R_base_target.T for t in turns], process), lengths=False
        )
    found = {}
    for pose_id, place_of, turn, (_, _, held_out) in zip(
        commands, estimate_deviations(tied), rotations, deviations, strict=True
    ):
        found[pose_id] = tied_accuracy(
            place_of,
            turn,
            commands[pose_id].rotation(),
            None if held_out is None else HeldOutDeviation(held_out),
            tied.degrees_of_freedom,
            point,
        )
    of_images = any(visit.image is not None for of_pose in chosen.values() for visit in of_pose)
    of_scale = scale_warnings(tie.scale, tie.degrees_of_freedom, instrument=not of_images)
    return {p: one for p, one in found.items() if one is not None}, (*tie.warnings, *of_scale)


def of_a_point(visits: Visits, commands: Commands, process: CycleProcess | None) -> Compared:
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

    def observation(station: Sequence[str]) -> PositionObservation:
        c = commands[station[0]]
        return PositionObservation(
            name_of(station),
            mean_position(all_visits(station, visits)),
            commanded_pose(c) if known else transform(np.eye(3), commanded_position(c)),
        )

    stations = stations_of({p: command_key(c) for p, c in commands.items()}, commands, visits)
    observed = [observation(station) for station in stations]
    tie = calibrate_from_positions(observed)
    place = {p: i for i, station in enumerate(stations) for p in station}
    deviations = [position_in_frames(tie, place[p], observed[place[p]], observation((p,))) for p in commands]
    R_base_instrument = tie.T_base_target[:3, :3].T
    chosen = {p: visits[p] for p in commands}
    # What the tie calls attained is here what was commanded, seen by the instrument.
    residuals = -tie.deviations_mm @ R_base_instrument.T
    offsets = [off - tie.deviations_mm[place[p]] for p, (off, _, _) in zip(commands, deviations, strict=True)]
    none = np.zeros((3, 0))
    tied = tied_deviations(
        stations,
        chosen,
        mean_position_noise(list(chosen.values()), process),
        [
            (off, R_base_instrument @ leverage @ R_base_instrument.T, none, used)
            for off, leverage, used in zip(residuals, tie.leverage, tie.used.tolist(), strict=True)
        ],
        [
            (residuals[place[p]] - R_base_instrument @ offset, none)
            for p, offset in zip(commands, offsets, strict=True)
        ],
    )
    found = {}
    for pose_id, of_pose, (_, _, held_out) in zip(
        commands, estimate_deviations(tied), deviations, strict=True
    ):
        found[pose_id] = tied_accuracy(
            of_pose,
            None,
            None,
            None if held_out is None else HeldOutDeviation(-R_base_instrument @ held_out),
            tied.degrees_of_freedom,
            CommandedPoint(R_base_instrument, np.zeros(3)),
        )
    scale = None if tie.scale is None else tie.scale.inverse
    warnings += [*tie.warnings, *scale_warnings(scale, tie.degrees_of_freedom, instrument=True)]
    return {p: one for p, one in found.items() if one is not None}, tuple(warnings)


def _mean_poses(stations: Sequence[Sequence[str]], visits: Visits) -> Float[np.ndarray, "n 4 4"]:
    return np.array([transform_mean(transforms_of(all_visits(station, visits))) for station in stations])


def _observation(
    station: Sequence[str], T: Float[np.ndarray, "4 4"], commands: Commands, visits: Visits
) -> PositionObservation:
    of_station = all_visits(station, visits)
    # Of another instrument only the scatter of the positions themselves is taken.
    common = mean_common(of_station)
    covariances = own_covariances(of_station) if common is not None else None
    return PositionObservation(
        name_of(station),
        commanded_position(commands[station[0]]),
        T,
        None if covariances is None else covariances.mean(axis=0),
        common,
    )


def _about_the_mean(
    stations: Sequence[Sequence[str]],
    visits: Visits,
    turns: Sequence[Float[np.ndarray, "_ 3"]],
    process: CycleProcess | None,
) -> TiedDeviations:
    """Return deviations of orientation from the stations' mean one, which stands for the camera's on the flange;
    `turns` are of stations and of poses.
    """
    share, none = np.eye(3) / len(stations), np.zeros((3, 0))
    return tied_deviations(
        stations,
        visits,
        mean_rotation_noise(list(visits.values()), process),
        [(turn, share, none, True) for turn in turns[0]],
        [(turn, none) for turn in turns[1]],
    )
