"""Pose accuracy against what the robot was told: possible once the session's own poses tie the frames together.

Where the target stands in the robot's base and the camera sits on the flange is estimated from the commanded poses
themselves (`core.calibration.hand_eye`), so that each pose is compared in frames tied by all the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from app.services.analyses.estimation import EstimatedImage
from app.services.analyses.snapshot import Commanded, Snapshot
from core import Advisory, GridposeError
from core.calibration.hand_eye import (
    Deviation,
    PositionStation,
    average_station,
    tie_frames,
    tie_positions,
)
from core.metrology import Figures, pose_accuracy
from core.transforms import rpy_to_rotation, so3_exp, transform, transform_mean


@dataclass(frozen=True, slots=True)
class Accuracy:
    """AP by pose, mm and rad, for those that could be compared; what to know of it."""

    poses: Mapping[str, Figures[float | None]]
    warnings: tuple[Advisory, ...]


def assess_accuracy(snapshot: Snapshot, poses: Mapping[str, Sequence[EstimatedImage]]) -> Accuracy:
    """Compare the mean of every pose's images with what was commanded; all of `poses` show one target each."""
    told = {
        pose_id: c
        for pose_id in poses
        if (c := snapshot.commanded.get(pose_id)) and c.position_mm is not None
    }
    if not told:
        return unavailable(
            "The poses' commanded positions are not known.",
            "PUT the session's poses with what was commanded.",
        )
    targets = [poses[pose_id][0].image.target for pose_id in told]
    target = max(sorted(set(targets)), key=targets.count)
    told = {pose_id: c for pose_id, c in told.items() if poses[pose_id][0].image.target == target}
    try:
        if all(commanded_rotation(c) is None for c in told.values()):
            return _by_positions(poses, told)
        return _by_poses(
            poses, {pose_id: c for pose_id, c in told.items() if commanded_rotation(c) is not None}
        )
    except GridposeError as failure:
        return unavailable(failure.detail, failure.advice)


def unavailable(reason: str, advice: str | None) -> Accuracy:
    """Return that nothing could be compared, and why."""
    return Accuracy({}, (Advisory("accuracy_unavailable", f"Accuracy is not given: {reason}", advice),))


def commanded_rotation(commanded: Commanded) -> Float[np.ndarray, "3 3"] | None:
    """Return how the robot was told to turn its flange; None where that is not known whole."""
    angles = (commanded.roll_deg, commanded.pitch_deg, commanded.yaw_deg)
    if any(angle is None for angle in angles):
        return None
    return rpy_to_rotation(np.radians(np.array(angles, dtype=np.float64)))


def _measured(images: Sequence[EstimatedImage]) -> Float[np.ndarray, "n 4 4"]:
    return np.array([transform(e.rotation, e.position_mm) for e in images])


def _own_covariances(images: Sequence[EstimatedImage]) -> Float[np.ndarray, "n 6 6"]:
    return np.array([e.covariance - e.common @ e.common.T for e in images])


def _by_poses(poses: Mapping[str, Sequence[EstimatedImage]], told: Mapping[str, Commanded]) -> Accuracy:
    commanded = {}
    stations = []
    for pose_id, c in told.items():
        rotation = commanded_rotation(c)
        assert rotation is not None
        commanded[pose_id] = transform(rotation, np.array(c.position_mm, dtype=np.float64))
        images = poses[pose_id]
        stations.append(
            average_station(
                pose_id,
                commanded[pose_id],
                _measured(images),
                _own_covariances(images),
                np.mean([e.common for e in images], axis=0),
            )
        )
    tie = tie_frames(stations)
    found = {d.pose_id: compared(d, commanded[d.pose_id]) for d in tie.deviations}
    return Accuracy(found, tie.warnings)


def compared(deviation: Deviation, commanded: Float[np.ndarray, "4 4"]) -> Figures[float | None]:
    """Return AP by the frames that the other poses tie, where they suffice for that."""
    position, turn = deviation.held_out_position_mm, deviation.held_out_rotation
    if position is None or turn is None:
        position, turn = deviation.position_mm, deviation.rotation
    return pose_accuracy(
        commanded[:3, 3] + position, commanded[:3, 3], so3_exp(turn) @ commanded[:3, :3], commanded[:3, :3]
    )


def _by_positions(poses: Mapping[str, Sequence[EstimatedImage]], told: Mapping[str, Commanded]) -> Accuracy:
    stations = [
        PositionStation(
            pose_id,
            np.array(c.position_mm, dtype=np.float64),
            transform_mean(_measured(poses[pose_id])),
            _own_covariances(poses[pose_id]).mean(axis=0),
        )
        for pose_id, c in told.items()
    ]
    tie = tie_positions(stations)
    found = {}
    for station, fitted, held_out in zip(stations, tie.deviations_mm, tie.held_out_mm, strict=True):
        attained = station.position_base_mm + (fitted if held_out is None else held_out)
        found[station.pose_id] = pose_accuracy(attained, station.position_base_mm)
    return Accuracy(found, tie.warnings)
