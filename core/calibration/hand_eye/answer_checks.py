"""Which hand-eye calibrations are answers, and what to know of them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr, stdtrit

from core.calibration.hand_eye.deviations import FramesFit
from core.calibration.hand_eye.result import ScaleDifference, rejected_poses
from core.errors import Advisory, MotionInsufficient, NotConverged

CORRECT_PITCH = (
    "Measure the print over its whole length: a page that was fitted to its paper is a few percent off. If its pitch "
    "is another one, make a target with that pitch and its standard uncertainty, and give the session that target "
    "(target_ids; `gridpose targets create`, `gridpose sessions change SESSION --target TARGET`)."
)
"""What to do about a print of another pitch than stated: the grid of a target never changes."""
LARGE_DEVIATION = 0.01
"""Standard deviation, in rad and of the working distance, from which on a robot is not the likely reason."""
MAX_UNCERTAINTY = 0.05
"""Largest standard uncertainty of the camera on the flange that is an answer: in rad, and of the working distance."""
MIN_SCALE_DIFFERENCE, MIN_SCALE_SIGMAS = 5e-3, 4.0
"""Smallest scale of commanded to measured distances, less 1, and in standard deviations of a normal, that is worth a
warning; also in those of the scales that the robot's other errors would be. A robot's own errors resemble a scale over
a small region: .2 % of a UR10 at 25 poses, before a laser tracker.
"""

_OF_PRINT = (
    "the images show them",
    f"{CORRECT_PITCH} If the pitch is right, the robot's lengths are off: identify it (dh).",
)
_OF_INSTRUMENT = (
    "the instrument measured them",
    "Check the instrument's scale against a known length, its correction for temperature and air, the unit of its "
    "export, and that it measures the commanded point. If these are right, the robot's lengths are off: identify it "
    "(dh).",
)
"""What commanded distances differ from, and advice."""


def check_answer(found: FramesFit, distance: float, warnings: Sequence[Advisory]) -> None:
    """Refuse where the camera on the flange is uncertain beyond the first-order model.

    Raises MotionInsufficient, or NotConverged where deviations too large for a robot are the reason.
    """
    values, vectors = np.linalg.eigh(found.covariance[:3, :3])
    worst = math.sqrt(values[-1])
    turn = math.sqrt(float(np.linalg.eigvalsh(found.covariance[3:6, 3:6])[-1]))
    if worst > MAX_UNCERTAINTY * distance or turn > MAX_UNCERTAINTY:
        for warning in warnings:
            if warning.code == "hand_eye_residuals_large":
                raise NotConverged(f"The frames cannot be tied. {warning.detail}", warning.advice)
        axis = ", ".join(f"{value:.2f}" for value in vectors[:, -1])
        raise MotionInsufficient(
            "The poses hardly determine where the camera sits on the flange: standard uncertainty "
            f"{worst:.3g} mm along ({axis}) of the flange, {math.degrees(turn):.2g}° in rotation."
        )


def warnings_of(robot: tuple[float, float], distance: float, wrong: Sequence[str]) -> list[Advisory]:
    """Return what to know of a calibration: poses that were rejected, deviations too large for a robot.

    `robot` are its deviations along each axis, mm and rad, `distance` the working distance, mm.
    """
    found = list(rejected_poses(wrong))
    if robot[0] > LARGE_DEVIATION * distance or robot[1] > LARGE_DEVIATION:
        found.append(
            Advisory(
                "hand_eye_residuals_large",
                f"Commanded and measured poses differ by {robot[0]:.3g} mm and {math.degrees(robot[1]):.2g}° (standard "
                "deviation along each axis), which is more than robots are off.",
                "Check the commanded values (millimetres, R = Rz Ry Rx, the same tool for all), the images' pose_id "
                "and the target's pitch.",
            )
        )
    return found


def scale_warnings(
    scale: ScaleDifference | None, degrees_of_freedom: float, *, instrument: bool = False
) -> list[Advisory]:
    """Name commanded distances that are longer or shorter than measured ones, all of them.

    `degrees_of_freedom` are those of the robot's variances: of few poses they are known less, by Student's t.
    `instrument`: another one than a camera measured.
    """
    if scale is None:
        return []
    limit = float(stdtrit(max(degrees_of_freedom - 1.0, 1.0), ndtr(MIN_SCALE_SIGMAS)))
    own = MIN_SCALE_SIGMAS * scale.like_of_robot
    if abs(scale.value) < max(MIN_SCALE_DIFFERENCE, limit * scale.standard_uncertainty, own):
        return []
    seen, advice = _OF_INSTRUMENT if instrument else _OF_PRINT
    return [
        Advisory(
            "instrument_scale_mismatch" if instrument else "print_scale_mismatch",
            f"Commanded distances are {100.0 * abs(scale.value):.3g} % {'longer' if scale.value > 0.0 else 'shorter'} "
            f"than {seen}, by one factor, with a standard uncertainty of {100.0 * scale.standard_uncertainty:.1g} %.",
            advice,
        )
    ]
