"""Pose accuracy of what images show, against what the robot was told: possible once the session's own poses tie the
frames together.

Where the target stands in the robot's base and the camera sits on the flange is estimated from the commanded poses
themselves (`core.calibration.hand_eye`), so that each pose is compared in frames tied by all the others.
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
from app.services.analyses.estimation import EstimatedImage
from app.services.analyses.snapshot import Snapshot
from core.calibration.hand_eye import PositionStation, average_station, tie_frames
from core.transforms import transform, transform_mean

Poses = Mapping[str, Sequence[EstimatedImage]]


def assess_accuracy(snapshot: Snapshot, poses: Poses) -> Accuracy:
    """Compare the mean of every pose's images with what was commanded; all of a pose's show one target."""
    return compare_with_commands(
        snapshot,
        {pose_id: images[0].image.target for pose_id, images in poses.items()},
        Ways(lambda _: True, lambda told: _by_poses(poses, told), lambda told: _by_positions(poses, told)),
    )


def _measured(images: Sequence[EstimatedImage]) -> Float[np.ndarray, "n 4 4"]:
    return np.array([transform(e.rotation, e.position_mm) for e in images])


def _own_covariances(images: Sequence[EstimatedImage]) -> Float[np.ndarray, "n 6 6"]:
    return np.array([e.covariance - e.common @ e.common.T for e in images])


def _by_poses(poses: Poses, told: Told) -> Accuracy:
    whole = {pose_id: c for pose_id, c in told.items() if commanded_rotation(c) is not None}
    stations = [
        average_station(
            pose_id,
            commanded_pose(c),
            _measured(poses[pose_id]),
            _own_covariances(poses[pose_id]),
            np.mean([e.common for e in poses[pose_id]], axis=0),
        )
        for pose_id, c in whole.items()
    ]
    others = {pose_id: _measured(poses[pose_id]) for pose_id in told if pose_id not in whole}
    return of_tie(tie_frames(stations), told, others)


def _by_positions(poses: Poses, told: Told) -> Accuracy:
    stations = [
        PositionStation(
            pose_id,
            np.array(c.position_mm, dtype=np.float64),
            transform_mean(_measured(poses[pose_id])),
            _own_covariances(poses[pose_id]).mean(axis=0),
        )
        for pose_id, c in told.items()
    ]
    return by_measured_orientation(stations)
