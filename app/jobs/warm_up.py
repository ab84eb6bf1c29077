"""The first picture of a new process, before any job: what is compiled on first use is compiled then.

`python -m app.jobs.warm_up` at the end of an installation compiles what pictures of all kinds of targets need, so that
the machine code is kept and no job ever has to wait for it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8, UInt16

from core import Camera, TargetSpec, calibrate_targets
from core.calibration.estimators import estimate_group
from core.kinematics.dh import pose_with_jacobian
from core.simulation import Scene, render
from core.targets import GridPoints
from core.transforms import so3_exp, transform

CHESSBOARD = TargetSpec("chessboard", 7, 5, pitch_mm=10.0)
BOARDS = (
    CHESSBOARD,
    TargetSpec("charuco", 6, 4, pitch_mm=13.0, marker_mm=10.0, dictionary="DICT_4X4_50"),
    TargetSpec("circles", 5, 4, pitch_mm=14.0),
    TargetSpec("asymmetric_circles", 4, 5, pitch_mm=9.0),
    TargetSpec("aprilgrid", 3, 3, pitch_mm=26.0, marker_mm=20.0),
)
_CAMERA = Camera(300.0, 300.0, 159.5, 119.5)
_SIZE_PX = (320, 240)
_PART_PX = 190
"""Columns of a picture that a part of the board fills."""
_AHEAD_MM = np.array([0.0, 0.0, 120.0])
_TILT = so3_exp(np.array([math.radians(35.0), 0.0, 0.1]))

Picture = UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"]


def warm_up() -> None:
    """Calibrate a small rendered board, by the way that every job's picture takes, and pool it as analyses do."""
    points = _measured(picture(CHESSBOARD), CHESSBOARD)
    estimate_group([points, points], "pooled", repeats=["home", "home"])


def warm_up_the_rest() -> None:
    """Compile what is kept on disk for later: boards of all kinds, whole and in part, in 8 and 16 bit, with what may be
    printed on them; pictures of one kind that are searched for the others; and the kinematics of analyses."""
    for bit_depth in (8, 16):
        for board in BOARDS:
            view = picture(board, bit_depth=bit_depth)
            _measured(view, board)
            _searched(view, BOARDS)
            _searched(np.ascontiguousarray(view[:, :_PART_PX]), [board])
        marked = picture(CHESSBOARD, bit_depth=bit_depth, marks=True)
        _measured(marked, CHESSBOARD)
        _searched(np.ascontiguousarray(marked[:, :_PART_PX]), [CHESSBOARD])
        _measured(picture(BOARDS[2], bit_depth=bit_depth, origin_dot=1.5), BOARDS[2])
    _searched(picture(CHESSBOARD), [CHESSBOARD], ".jpg")
    pose_with_jacobian(np.zeros((2, 5)), np.zeros((1, 2)), np.eye(4)[None], np.eye(4))


def picture(
    board: TargetSpec, *, bit_depth: int = 8, marks: bool = False, origin_dot: float = 1.0, seed: int = 0
) -> Picture:
    """Return a small rendered picture of a tilted board."""
    middle_mm = board.points_target().mean(axis=0)
    scene = Scene(
        target=board,
        camera=_CAMERA,
        T_camera_target=transform(_TILT, _AHEAD_MM - _TILT @ middle_mm),
        width_px=_SIZE_PX[0],
        height_px=_SIZE_PX[1],
        noise_levels=2.0,
        bit_depth=bit_depth,
        marks=marks,
        origin_dot=origin_dot,
        seed=seed,
    )
    return render(scene)


def _measured(view: Picture, board: TargetSpec) -> GridPoints:
    """Return the grid points of a calibrated picture; an installation that cannot do this one can do no other."""
    (outcome,) = calibrate_targets(_encoded(view), [board])
    if outcome.failure is not None:
        raise outcome.failure
    assert outcome.calibration is not None
    return outcome.calibration.points


def _searched(view: Picture, boards: Sequence[TargetSpec], extension: str = ".png") -> None:
    """Look for boards that may be there only in part, or not at all: what is refused, too, runs through the kernels."""
    for _ in calibrate_targets(_encoded(view, extension), boards):
        pass


def _encoded(view: Picture, extension: str = ".png") -> bytes:
    return cv2.imencode(extension, view)[1].tobytes()


if __name__ == "__main__":
    warm_up()
    warm_up_the_rest()
