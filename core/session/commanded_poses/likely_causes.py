"""Why no camera on the flange explains poses: what moved otherwise than hand-eye calibration takes it to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from core.calibration import HandEyeCalibration, HandEyeObservation, PoseResidual, calibrate_hand_eye
from core.errors import GridposeError, InvalidArgument, NotConverged
from core.geometry import so3_log
from core.session.commanded_poses.other_mount import RESIDUALS_LARGE, far_better
from core.session.model import CameraMount

MIN_TURN = math.radians(5.0)
"""Turn of one set of poses from which on the other set ought to turn too."""
STILL_SHARE = 0.1
"""A set of poses that turns by less than this share of the other's turn stands still."""
MAX_REJECTED_SHARE = 0.2
"""Of the poses: where more were rejected, the mount may be the reason."""
_ON_FLANGE = {"robot": ("camera", "target"), "fixed": ("target", "camera")}
"""What is on the flange, and what is fixed in the cell, by the camera's mount."""

_IN_MM = "State the commanded positions in millimetres, or import them with their unit."
_RIGHT_HANDED = (
    "State the commanded positions in the robot's right-handed base frame, in which their orientations are."
)
_OTHER_POSITIONS = (
    ((1000.0, 1000.0, 1000.0), "With the commanded positions taken as metres", _IN_MM),
    ((25.4, 25.4, 25.4), "With the commanded positions taken as inches", _IN_MM),
    ((-1.0, 1.0, 1.0), "With the commanded positions mirrored along x", _RIGHT_HANDED),
    ((1.0, -1.0, 1.0), "With the commanded positions mirrored along y", _RIGHT_HANDED),
    ((1.0, 1.0, -1.0), "With the commanded positions mirrored along z", _RIGHT_HANDED),
)
"""By what commanded positions are multiplied, how that is said, and what to do if the poses agree then."""


def calibrate_or_explain(
    stations: Sequence[HandEyeObservation], mount: CameraMount | None
) -> HandEyeCalibration:
    """Calibrate as `calibrate_hand_eye` does; where no frames explain the poses, say which motion is the likely cause.

    Stations are of what moves in what stands still (`core.session.camera_mount`); `mount` None: no camera measured
    them, and nothing is explained. Where the deviations are large or many poses were rejected, and the other mount ties
    them far better, the warning `camera_mount_unlikely` says so.

    Raises what `calibrate_hand_eye` raises.
    """
    try:
        tie = calibrate_hand_eye(stations)
    except (NotConverged, InvalidArgument) as failure:
        if mount is None:
            raise
        raise _explained(failure, stations, mount) from failure
    rejected = [one for one in tie.deviations if not one.used]
    large = any(warning.code == RESIDUALS_LARGE for warning in tie.warnings)
    if mount is None or not (large or len(rejected) > MAX_REJECTED_SHARE * len(stations)):
        return tie
    deviations = tie.robot_position_mm, tie.robot_rotation
    if not large:  # What was rejected is what another mount would have to explain.
        deviations = _rms(tie.deviations)
    found = far_better(stations, mount, deviations, None if large else len(rejected))
    return tie if found is None else replace(tie, warnings=(*tie.warnings, found))


def _rms(deviations: Sequence[PoseResidual]) -> tuple[float, float]:
    """Return the root mean square deviation of all stations along an axis, in position (mm) and rotation (rad)."""
    every = [
        np.array([one.position_mm for one in deviations]),
        np.array([one.rotation for one in deviations]),
    ]
    position, rotation = (math.sqrt(float(np.mean(of_kind**2))) for of_kind in every)
    return position, rotation


def _explained(
    failure: GridposeError, stations: Sequence[HandEyeObservation], mount: CameraMount
) -> GridposeError:
    kind = type(failure)
    moving, fixed = _ON_FLANGE[mount]
    commanded = _turn(np.array([s.T_base_flange for s in stations]))
    seen = _turn(np.array([s.T_target_camera for s in stations]))
    turns = f"the commanded poses turn by up to {math.degrees(commanded):.1f}°, the images by {math.degrees(seen):.1f}°"
    if commanded > MIN_TURN and seen < STILL_SHARE * commanded:
        return kind(
            f"{failure.detail} The {moving} stands still before the {fixed}: {turns}.",
            f"Mount the {moving} on the flange and the {fixed} in the cell, and take each image after the robot "
            "reached its pose.",
        )
    if seen > MIN_TURN and commanded < STILL_SHARE * seen:
        return kind(
            f"{failure.detail} The commanded poses do not turn as the {moving} does: {turns}.",
            "State each pose's own roll_deg, pitch_deg and yaw_deg, in degrees (R = Rz Ry Rx).",
        )
    found = far_better(stations, mount, (math.inf, math.inf))
    if found is not None:
        return kind(f"{failure.detail} {found.detail}", found.advice)
    for factors, what, advice in _OTHER_POSITIONS:
        agreeing = _with_positions(stations, np.array(factors))
        if agreeing is not None:
            return kind(
                f"{failure.detail} {what} the poses agree to {agreeing.robot_position_mm:.2g} mm.", advice
            )
    return kind(
        failure.detail,
        f"{failure.advice} If these are right: the {moving} has to be on the flange and the {fixed} in the cell, not "
        "the other way round, and each image has to be taken after the robot reached its pose.",
    )


def _with_positions(
    stations: Sequence[HandEyeObservation], factors: Float[np.ndarray, "3"]
) -> HandEyeCalibration | None:
    """Return the frames with commanded positions in other units or mirrored; None where they explain no more."""
    others = []
    for one in stations:
        T = one.T_base_flange.copy()
        T[:3, 3] *= factors
        others.append(replace(one, T_base_flange=T))
    try:
        tie = calibrate_hand_eye(others)
    except GridposeError:
        return None
    rejected = sum(not one.used for one in tie.deviations)
    large = any(warning.code == RESIDUALS_LARGE for warning in tie.warnings)
    return None if large or rejected > MAX_REJECTED_SHARE * len(stations) else tie


def _turn(T: Float[np.ndarray, "n 4 4"]) -> float:
    """Return the largest angle (rad) between the first orientation and another one."""
    return max(float(np.linalg.norm(so3_log(T[0, :3, :3].T @ R))) for R in T[:, :3, :3])
