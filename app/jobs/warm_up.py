"""The first picture of a new process, before any job: what is compiled on first use is compiled then.

`python -m app.jobs.warm_up` does the same at the end of an installation, so that the machine code is kept and no
worker ever has to wait for it.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from core import Camera, TargetSpec, calibrate_image
from core.calibration.estimators import estimate_group
from core.kinematics.dh import pose_with_jacobian
from core.simulation import Scene, render
from core.targets import detect
from core.transforms import so3_exp, transform

_TARGET = TargetSpec("chessboard", 7, 5, pitch_mm=10.0)
_CAMERA = Camera(300.0, 300.0, 159.5, 119.5)
_MIDDLE_MM = np.array([30.0, 20.0, 0.0])
_AHEAD_MM = np.array([0.0, 0.0, 120.0])
_TILT = so3_exp(np.array([math.radians(35.0), 0.0, 0.1]))


def warm_up() -> None:
    """Calibrate a small rendered board, by the way that every picture takes, and pool it as analyses do."""
    scene = Scene(
        target=_TARGET,
        camera=_CAMERA,
        T_camera_target=transform(_TILT, _AHEAD_MM - _TILT @ _MIDDLE_MM),
        width_px=320,
        height_px=240,
        noise_levels=2.0,
    )
    found = calibrate_image(cv2.imencode(".png", render(scene))[1].tobytes(), _TARGET)
    estimate_group([found.points, found.points], "pooled", repeats=["home", "home"])


def warm_up_the_rest() -> None:
    """Compile what is kept on disk for later: boards of dots, and the kinematics of analyses."""
    dots = TargetSpec("circles", 5, 4, pitch_mm=14.0)
    middle = dots.points_target().mean(axis=0)
    scene = Scene(dots, _CAMERA, transform(_TILT, _AHEAD_MM - _TILT @ middle), 320, 240, noise_levels=2.0)
    detect(render(scene), dots)
    pose_with_jacobian(np.zeros((2, 5)), np.zeros((1, 2)), np.eye(4)[None], np.eye(4))


if __name__ == "__main__":
    warm_up()
    warm_up_the_rest()
