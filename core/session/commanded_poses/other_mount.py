"""What to say where the other camera mount ties the stations of a session far better than its own.

A fixed camera taken for one on the robot, and poses of the base in the flange taken for those of the flange in the
base, are one and the same error in the equations: the stations agree when the measured poses are inverted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from core.calibration import HandEyeObservation, calibrate_hand_eye
from core.errors import Advisory, GridposeError
from core.geometry import invert
from core.session.camera_mount import inverse_covariance, inverse_effects
from core.session.model import CameraMount

MAX_SHARE = 0.3
"""Of the deviations: where the other mount leaves less, of positions and of rotations, it is the likely one."""
MOUNT_UNLIKELY = "camera_mount_unlikely"
RESIDUALS_LARGE = "hand_eye_residuals_large"
_SAID = {
    "robot": "With the camera fixed and the target on the flange",
    "fixed": "With the camera on the robot and the target fixed",
}
_ADVICE = {
    "robot": "If the camera stands still and the target is on the robot, set the session's camera_mount to fixed. If "
    "the camera is on the robot, the poses stated are of the base in the flange: state those of the flange in the "
    "base.",
    "fixed": "If the camera is on the robot, set the session's camera_mount to robot. If it stands still, the poses "
    "stated are of the base in the flange: state those of the flange in the base.",
}


def far_better(
    stations: Sequence[HandEyeObservation],
    mount: CameraMount,
    deviations: tuple[float, float],
    rejected: int | None = None,
) -> Advisory | None:
    """Return what to say where the other mount ties the stations before one target far better; else None.

    Stations are of what moves in what stands still (`core.session.camera_mount`). `deviations` are the robot's in
    position (mm) and rotation (rad) as `mount` ties them; of all stations where it `rejected` some of them, and the
    other mount has to reject fewer.
    """
    try:
        other = calibrate_hand_eye([_inverse(one) for one in stations if one.target == stations[0].target])
    except GridposeError:
        return None
    found = other.robot_position_mm, other.robot_rotation
    if rejected is not None and sum(not one.used for one in other.deviations) >= rejected:
        return None
    if any(warning.code == RESIDUALS_LARGE for warning in other.warnings):
        return None
    if any(one > MAX_SHARE * before for one, before in zip(found, deviations, strict=True)):
        return None
    return Advisory(
        "camera_mount_unlikely",
        f"{_SAID[mount]} the same poses agree to {found[0]:.2g} mm and {math.degrees(found[1]):.2g}°.",
        _ADVICE[mount],
    )


def _inverse(station: HandEyeObservation) -> HandEyeObservation:
    T = station.T_target_camera
    effects = inverse_effects(T[None, :3, 3], T[None, :3, :3])
    covariance = (
        None if station.covariance is None else inverse_covariance(station.covariance[None], effects)[0]
    )
    common = None if station.common is None else np.asarray(effects[0] @ station.common)
    return replace(station, T_target_camera=invert(T), covariance=covariance, common=common, target=0)
