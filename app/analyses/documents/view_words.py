"""A view in one line for whoever stands at the camera: tilt, turn, where the target is to appear, and how far away."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.calibration import CommonFit

SQUARE_DEG = 5.0
"""A smaller tilt is not worth a word; nor is a turn of twice as much."""
NEARER, FARTHER = 0.85, 1.15
"""Of the median distance of the images so far."""
_EDGES = ("right", "lower right", "lower", "lower left", "left", "upper left", "upper", "upper right")
_COLUMNS, _ROWS = ("left", "", "right"), ("upper", "", "lower")
_ALONE = {"upper": "top", "lower": "bottom"}
"""A row's name where no column's follows it."""


def instruction(
    T_camera_target: Float[np.ndarray, "4 4"],
    middle_px: Float[np.ndarray, "2"],
    distance_mm: float,
    fit: CommonFit,
) -> str:
    """Return words for a view; `fit` has the images so far, with which distances and turns are compared."""
    parts = [
        _tilt(T_camera_target[:, 2]),
        *_turn(T_camera_target, fit),
        _place(middle_px, fit.views.image_width_px, fit.views.image_height_px),
        _distance(distance_mm, fit),
    ]
    return ", ".join(parts)


def _tilt(normal_camera: Float[np.ndarray, "4"]) -> str:
    """Return the tilt by the target's normal, which points into the board: depth grows against its x and y."""
    x, y, z = (float(value) for value in normal_camera[:3])
    tilt = math.degrees(math.acos(min(max(z, -1.0), 1.0)))
    if tilt < SQUARE_DEG:
        return "face the target squarely"
    edge = _EDGES[round(math.degrees(math.atan2(-y, -x)) / 45.0) % len(_EDGES)]
    axis = {"upper": "x", "lower": "x", "left": "y", "right": "y"}.get(edge)
    about = f" about {axis}" if axis else ""
    away = f"{edge} edge away" if axis else f"{edge} corner away"
    return f"tilt {tilt:.0f}°{about} ({away})"


def _turn(T_camera_target: Float[np.ndarray, "4 4"], fit: CommonFit) -> list[str]:
    """Return the turn about the optical axis from the mean one of the images so far, if it is worth a word."""
    R = fit.placements.rotations
    mean = np.sum(np.exp(1j * np.arctan2(R[:, 1, 0], R[:, 0, 0])))
    turned = np.exp(1j * math.atan2(T_camera_target[1, 0], T_camera_target[0, 0])) * np.conj(mean)
    angle = math.degrees(float(np.angle(turned)))
    if abs(angle) < 2.0 * SQUARE_DEG:
        return []
    return [f"turn the image {abs(angle):.0f}° {'clockwise' if angle > 0.0 else 'anticlockwise'}"]


def _place(middle_px: Float[np.ndarray, "2"], width_px: int, height_px: int) -> str:
    column, row = (
        names[min(max(int(3.0 * value / size), 0), 2)]
        for names, value, size in zip(
            (_COLUMNS, _ROWS), middle_px.tolist(), (width_px, height_px), strict=True
        )
    )
    where = " ".join(word for word in (row, column) if word)
    return f"target at the {_ALONE.get(where, where)}" if where else "target in the middle"


def _distance(distance_mm: float, fit: CommonFit) -> str:
    so_far = float(np.median(np.linalg.norm(fit.placements.translations_mm, axis=1)))
    share = distance_mm / so_far
    compared = " (nearer)" if share < NEARER else " (farther)" if share > FARTHER else ""
    return f"{distance_mm:.0f} mm away{compared}"
