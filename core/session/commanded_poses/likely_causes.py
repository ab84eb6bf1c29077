"""Why no camera on the flange explains poses: what moved otherwise than hand-eye calibration takes it to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from core.calibration import HandEyeCalibration, HandEyeObservation, calibrate_hand_eye
from core.errors import GridposeError, InvalidArgument, NotConverged
from core.geometry import invert, so3_log

MIN_TURN = math.radians(5.0)
"""Turn of one set of poses from which on the other set ought to turn too."""
STILL_SHARE = 0.1
"""A set of poses that turns by less than this share of the other's turn stands still."""
_GENERAL = (
    "If these are right: the camera has to be on the flange and the target in the cell, not the other way round, and "
    "each image has to be taken after the robot reached its pose."
)


def calibrate_or_explain(stations: Sequence[HandEyeObservation]) -> HandEyeCalibration:
    """Calibrate as `calibrate_hand_eye` does; where no frames explain the poses, say which motion is the likely cause.

    Raises what `calibrate_hand_eye` raises.
    """
    try:
        return calibrate_hand_eye(stations)
    except (NotConverged, InvalidArgument) as failure:
        raise _explained(failure, stations) from failure


def _explained(failure: GridposeError, stations: Sequence[HandEyeObservation]) -> GridposeError:
    kind = type(failure)
    commanded = _turn(np.array([s.T_base_flange for s in stations]))
    seen = _turn(np.array([s.T_target_camera for s in stations]))
    turns = f"the commanded poses turn by up to {math.degrees(commanded):.1f}°, the images by {math.degrees(seen):.1f}°"
    if commanded > MIN_TURN and seen < STILL_SHARE * commanded:
        return kind(
            f"{failure.detail} The camera stands still before the target: {turns}.",
            "Mount the camera on the flange and the target in the cell, and take each image after the robot reached "
            "its pose.",
        )
    if seen > MIN_TURN and commanded < STILL_SHARE * seen:
        return kind(
            f"{failure.detail} The commanded poses do not turn as the camera does: {turns}.",
            "State each pose's own roll_deg, pitch_deg and yaw_deg, in degrees (R = Rz Ry Rx).",
        )
    moved = _of_fixed_camera(stations)
    if moved is not None:
        return kind(
            f"{failure.detail} A camera that stands still before a target on the flange explains the poses (standard "
            f"deviation {1000.0 * moved:.0f} µm along each axis).",
            "Analyses take the camera to be on the flange: mount it there and the target in the cell. In Python, "
            "core.calibration.calibrate_hand_eye calibrates a camera that stands still.",
        )
    return kind(failure.detail, f"{failure.advice} {_GENERAL}")


def _turn(T: Float[np.ndarray, "n 4 4"]) -> float:
    """Return the largest angle (rad) between the first orientation and another one."""
    return max(float(np.linalg.norm(so3_log(T[0, :3, :3].T @ R))) for R in T[:, :3, :3])


def _of_fixed_camera(stations: Sequence[HandEyeObservation]) -> float | None:
    """Return the robot's deviation (mm) with a target on the flange before a fixed camera; None if it does not fit."""
    turned = [
        replace(s, T_target_camera=invert(s.T_target_camera), covariance=None, common=None, target=0)
        for s in stations
        if s.target == stations[0].target
    ]
    try:
        found = calibrate_hand_eye(turned)
    except GridposeError:
        return None
    if any(warning.code == "hand_eye_residuals_large" for warning in found.warnings):
        return None
    return found.robot_position_mm
