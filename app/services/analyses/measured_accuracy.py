"""Pose accuracy of what another instrument measured, against what the robot was told.

Where readings have orientations, the frames are tied as for a camera, with the probe in the camera's place. Readings of
positions alone (a reflector) are tied the other way about: the commanded poses say how the flange was turned, the
readings where one point of it was, and the nine unknowns of `core.calibration.hand_eye.positions` are the instrument in
the robot's base and that point on the flange.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from app.services.analyses.commanded_accuracy import (
    Accuracy,
    Told,
    Ways,
    by_measured_orientation,
    commanded_pose,
    commanded_rotation,
    compare_with_commands,
    of_tie,
)
from app.services.analyses.pose_rows import AnyVisit
from app.services.analyses.snapshot import Snapshot
from core import Advisory, GridposeError
from core.calibration.hand_eye import PositionStation, average_station, tie_frames, tie_positions
from core.calibration.hand_eye.tie import LEAST_TO_JUDGE
from core.metrology import pose_accuracy
from core.transforms import transform, transform_mean


def assess_measured_accuracy(snapshot: Snapshot, poses: Mapping[str, Sequence[AnyVisit]]) -> Accuracy:
    """Compare the mean of every pose's readings with what was commanded."""
    return compare_with_commands(
        snapshot,
        dict.fromkeys(poses, 0),
        Ways(
            lambda pose_id: _oriented(poses[pose_id]),
            lambda told: _by_poses(poses, told),
            lambda told: _by_positions(poses, told),
        ),
    )


def _oriented(visits: Sequence[AnyVisit]) -> bool:
    return all(v.rotation is not None for v in visits)


def _measured(visits: Sequence[AnyVisit]) -> Float[np.ndarray, "n 4 4"]:
    return np.array([transform(v.rotation, v.position_mm) for v in visits if v.rotation is not None])


def _by_poses(poses: Mapping[str, Sequence[AnyVisit]], told: Told) -> Accuracy:
    turned = {pose_id: c for pose_id, c in told.items() if _oriented(poses[pose_id])}
    measured = {pose_id: _measured(poses[pose_id]) for pose_id in turned}
    stations = []
    for pose_id, c in turned.items():
        if commanded_rotation(c) is None:
            continue
        covariances = [v.covariance for v in poses[pose_id] if v.covariance is not None]
        stations.append(
            average_station(
                pose_id,
                commanded_pose(c),
                measured[pose_id],
                np.array(covariances) if len(covariances) == len(measured[pose_id]) else None,
            )
        )
    others = {pose_id: measured[pose_id] for pose_id, c in turned.items() if commanded_rotation(c) is None}
    return of_tie(tie_frames(stations), told, others)


def _by_positions(poses: Mapping[str, Sequence[AnyVisit]], told: Told) -> Accuracy:
    if all(_oriented(poses[pose_id]) for pose_id in told):
        return by_measured_orientation(
            [
                PositionStation(
                    pose_id,
                    np.array(c.position_mm, dtype=np.float64),
                    transform_mean(_measured(poses[pose_id])),
                )
                for pose_id, c in told.items()
            ]
        )
    turned = {pose_id: c for pose_id, c in told.items() if commanded_rotation(c) is not None}
    if not LEAST_TO_JUDGE <= len(turned) < len(told):
        return _of_a_point(poses, told)
    try:
        # Where a point on the flange was is not known of the others: they are named.
        return _of_a_point(poses, turned)
    except GridposeError:
        return _of_a_point(poses, told)


def _of_a_point(poses: Mapping[str, Sequence[AnyVisit]], told: Told) -> Accuracy:
    """Tie with the roles exchanged: the readings are the places, the commanded poses say how the point was turned."""
    oriented = all(commanded_rotation(c) is not None for c in told.values())
    remarks: list[Advisory] = []
    if not oriented:
        remarks.append(
            Advisory(
                "point_on_flange_unknown",
                "Neither were orientations commanded for every pose, nor do all readings have one: accuracy takes the "
                "measured point for the commanded one, or every pose for turned alike.",
                "State the poses' commanded orientations.",
            )
        )
    stations = [
        PositionStation(
            pose_id,
            np.mean([v.position_mm for v in poses[pose_id]], axis=0),
            commanded_pose(c)
            if oriented
            else transform(np.eye(3), np.array(c.position_mm, dtype=np.float64)),
        )
        for pose_id, c in told.items()
    ]
    tie = tie_positions(stations)
    R_base_instrument = tie.T_base_target[:3, :3].T
    found = {}
    for station, fitted, held_out in zip(stations, tie.deviations_mm, tie.held_out_mm, strict=True):
        # What the tie calls attained is here what was commanded, seen by the instrument.
        deviation = -R_base_instrument @ (fitted if held_out is None else held_out)
        commanded = station.T_target_camera[:3, 3]
        found[station.pose_id] = pose_accuracy(commanded + deviation, commanded)
    return Accuracy(found, (*remarks, *tie.warnings))
