"""From a measurement as the API shows it to what its overlay draws; runs in the worker process."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from app.jobs.painting.statement import statement_of
from app.jobs.painting.subject import OverlaySubject
from app.reports.overlay import Axis, OverlayContent, Points
from core.geometry import Camera, project
from core.image import Preview
from core.targets import candidate_points

_AXIS_PITCHES = 2.0
_AXIS_NAMES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")


def overlay_content(subject: OverlaySubject, preview: Preview) -> OverlayContent:
    """Return everything that the overlay of a measurement shows."""
    points = None if subject.points is None else _points(subject.points)
    candidates = np.zeros((0, 2))
    if points is None and subject.measurement["status"] == "failed":
        candidates = _candidates(preview, subject.kind)
    return OverlayContent(
        preview.grey,
        preview.image_width_px,
        preview.image_height_px,
        statement_of(subject, preview.brightening, is_whole=preview.is_whole),
        points,
        _axes(subject),
        candidates,
    )


def _points(documents: list[dict[str, Any]]) -> Points:
    residuals = [(point["residual_u_px"], point["residual_v_px"]) for point in documents]
    return Points(
        np.array([(point["u_px"], point["v_px"]) for point in documents], dtype=np.float64).reshape(-1, 2),
        np.array(residuals, dtype=np.float64).reshape(-1, 2),  # None becomes NaN
        np.array([point["used"] is True for point in documents], dtype=np.bool_),
        np.array([point["used"] is not None for point in documents], dtype=np.bool_),
    )


def _candidates(preview: Preview, kind: str | None) -> Float[np.ndarray, "m 2"]:
    """Return candidates for grid points in pixels of the original."""
    height, width = preview.grey.shape
    scale = np.array([preview.image_width_px / width, preview.image_height_px / height])
    return np.asarray((candidate_points(np.ascontiguousarray(preview.grey), kind) + 0.5) * scale - 0.5)


def _axes(subject: OverlaySubject) -> tuple[Axis, ...]:
    """Return the target's axes: all three by the calibration, without it x and y by the grid points."""
    calibration = subject.measurement["calibration"]
    if calibration is not None and subject.pitch_mm is not None:
        return _projected_axes(calibration, subject.pitch_mm)
    places = {(p["column"], p["row"]): (p["u_px"], p["v_px"]) for p in subject.points or ()}
    ends = ((_AXIS_NAMES[0], (2, 0)), (_AXIS_NAMES[1], (0, 2)))
    return tuple(
        Axis(name, places[0, 0], places[end]) for name, end in ends if (0, 0) in places and end in places
    )


def _projected_axes(calibration: dict[str, Any], pitch_mm: float) -> tuple[Axis, ...]:
    T = np.array(calibration["T_camera_target"], dtype=np.float64)
    distortion = {name: calibration["distortion"][name] for name in ("k1", "k2", "p1", "p2", "k3")}
    camera = Camera(**calibration["intrinsics"], **distortion)
    ends = np.vstack([np.zeros(3), _AXIS_PITCHES * pitch_mm * np.eye(3)]) @ T[:3, :3].T + T[:3, 3]
    if np.any(ends[:, 2] <= 0.0):
        return ()
    start, *tips = (tuple(place) for place in project(ends, camera).tolist())
    return tuple(Axis(name, start, tip) for name, tip in zip(_AXIS_NAMES, tips, strict=True))
