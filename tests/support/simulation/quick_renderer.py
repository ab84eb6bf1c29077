"""Images of sheets in some ms: right to a tenth of a px, for tests that need thousands and no sub-pixel truth.

The sheet is drawn once, finer than the image, and looked up where each pixel's line of sight meets its plane; the
lens is evaluated on every eighth pixel and interpolated between. `core.simulation.renderer` is the exact one.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from core.geometry.camera import Camera, undistort_points
from core.targets.printed_pattern import DotPattern, RectilinearPattern

_STEP_PX = 8
_FINER = 1.6  # samples of the sheet to a pixel of the image
_LARGEST_DRAWING = 3000
_PARTS = 4  # bits of a sample that circles are placed by


def sheet_in_view(
    pattern: RectilinearPattern | DotPattern,
    camera: Camera,
    T_camera_target: Float[np.ndarray, "4 4"],
    size_px: tuple[int, int],
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Return how white each pixel's ink is, and how much of it is sheet, both 0 to 1, float32 and not blurred.

    `size_px` is width and height. Pixels that see the sheet's plane from behind, or not at all, see no sheet.
    """
    width, height = size_px
    per_mm = _FINER * camera.fx_px / float(T_camera_target[2, 3])
    extent = max(np.ptp(pattern.x_edges), np.ptp(pattern.y_edges))
    per_mm = min(per_mm, _LARGEST_DRAWING / extent)
    drawing = _dotted(pattern, per_mm) if isinstance(pattern, DotPattern) else _drawn(pattern, per_mm)
    # pixel k of a map enlarged so is place (k + ½) / step - ½ of the coarse one
    coarse = [np.arange(-1, side // _STEP_PX + 2) * _STEP_PX + 0.5 * (_STEP_PX - 1) for side in size_px]
    u, v = np.meshgrid(*coarse)
    rays = undistort_points(np.stack([u.ravel(), v.ravel()], axis=1), camera)
    to_plane = np.linalg.inv(T_camera_target[:3, [0, 1, 3]])
    plane = np.column_stack([rays, np.ones(len(rays))]) @ to_plane.T
    ahead = plane[:, 2] > 1e-9
    places = plane[:, :2] / np.where(ahead, plane[:, 2], 1.0)[:, None]
    places = (places - [pattern.x_edges[0], pattern.y_edges[0]]) * per_mm - 0.5
    places = np.clip(np.where(ahead[:, None], places, -1e4), -1e4, 1e4).astype(np.float32)
    whole = cv2.resize(
        places.reshape(*u.shape, 2),
        (u.shape[1] * _STEP_PX, u.shape[0] * _STEP_PX),
        interpolation=cv2.INTER_LINEAR,
    )
    inner = whole[_STEP_PX : _STEP_PX + height, _STEP_PX : _STEP_PX + width]
    along, down = (np.ascontiguousarray(inner[..., k]) for k in range(2))
    seen = cv2.remap(
        drawing, along, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(0, 0)
    )
    ink, sheet = (seen[..., k].astype(np.float32) / np.float32(255.0) for k in range(2))
    return ink, sheet


def _drawn(pattern: RectilinearPattern, per_mm: float) -> UInt8[np.ndarray, "h w 2"]:
    """Return the sheet from its upper left on, drawn with so many samples to the mm: ink and sheet."""
    index = []  # of the columns, and of the rows
    for edges in (pattern.x_edges, pattern.y_edges):
        count = math.ceil((edges[-1] - edges[0]) * per_mm)
        index.append(np.searchsorted(edges, edges[0] + (np.arange(count) + 0.5) / per_mm))
    fields = np.stack([(part * 255.0).astype(np.uint8) for part in (pattern.white, pattern.sheet)], axis=2)
    # Both bytes of a sample are taken as one number, and rows whole: many times as fast as by two indices.
    drawn = fields.view(np.uint16)[..., 0][:, index[0]][index[1]]
    return drawn.view(np.uint8).reshape(*drawn.shape, 2)


def _dotted(pattern: DotPattern, per_mm: float) -> UInt8[np.ndarray, "h w 2"]:
    """Return the blank sheet drawn, with the dots upon it."""
    drawing = _drawn(pattern.blank, per_mm)
    ink = np.ascontiguousarray(drawing[..., 0])
    q, p = np.nonzero(pattern.radius_mm)
    centres = (np.stack([p, q], axis=1) + pattern.first) @ np.linalg.inv(pattern.to_index).T
    places = (centres - [pattern.x_edges[0], pattern.y_edges[0]]) * per_mm - 0.5
    for place, radius in zip(places, pattern.radius_mm[q, p] * per_mm, strict=True):
        u, v, r = (round(float(value) * (1 << _PARTS)) for value in (*place, radius))
        below = ink[min(max(v >> _PARTS, 0), len(ink) - 1), min(max(u >> _PARTS, 0), ink.shape[1] - 1)]
        cv2.circle(ink, (u, v), r, 255 - int(below), cv2.FILLED, cv2.LINE_AA, _PARTS)
    drawing[..., 0] = ink
    return drawing
