"""Assess an image's quality: sharpness, motion, light, size and tilt, from the target's own edges.

**Blur.** Each edge of the target is a step before the lens and the motion blurred it. Across an edge with the normal
n the blur of covariance Σ (px²) has the variance nᵀ Σ n, read from the average edge's 10-90 % rise distance. A motion
follows from Σ (`motion_blur`).

**Light.** The ends of the same profiles lie on the target's white and black.

References: ISO 12233 for the edge profile.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, Int, Shaped

from core.errors import Advisory, DegenerateGeometry
from core.geometry import find_homography
from core.targets.image_quality.advice import advise
from core.targets.image_quality.edge_kernel import BINS_PER_PX, REACH_PX, average_profiles
from core.targets.image_quality.edge_profiles import (
    Edges,
    dot_edges,
    local_map,
    square_corners,
    square_edges,
    thinned,
)
from core.targets.image_quality.motion_blur import blur_covariance, motion_of
from core.targets.quality_result import CaptureQuality
from core.targets.specification import GridPoints

_MIN_REACH_RATIO = 1.5  # of the rise distance: nearer ends of an edge are not yet black and white
_MIN_CONTRAST = 0.03  # of full scale, of an edge that is looked at
_MIN_PROFILES = 4  # of a family
_SHARP_PX = 3.0  # the 10-90 % rise of a sharp image's edge
_HALVES_DIFFER = 0.25
_MIN_SHORTENED = 0.45  # of the longer side of a square, a tilt of 63°: beyond it motion is not determined
_TOP = 0.995  # of full scale

_MOTION_PX, _MOTION_SHARE = 2.0, 0.8  # the latter of the edges' width


_SHARPNESS_NOT_MEASURABLE = Advisory(
    "sharpness_not_measurable",
    "The target's edges are too wide, or the target too small in the image, to measure how sharp they are.",
    "Focus on the target and keep it at rest; if the image looks sharp, come nearer or take larger squares.",
)


def assess_capture(image: Shaped[np.ndarray, "h w"], points: GridPoints) -> CaptureQuality:
    """Assess the quality of an image (grey, uint8 or uint16) in which `points` were found."""
    full = 255.0 if image.dtype == np.uint8 else 65535.0
    is_dots = points.target.kind in ("circles", "asymmetric_circles")
    cells = None if is_dots else square_corners(points)
    H = _plane(points)
    edges = dot_edges(points, H) if cells is None else square_edges(points, cells)
    profiles = _average(image, edges, full)
    motion_px, direction = motion_of(blur_covariance(image, points, edges, profiles.rises, cells))
    measurable = np.isfinite(profiles.rises).any()
    quality = CaptureQuality(
        edge_width_px=float(np.nanmin(profiles.rises)) if measurable else None,
        motion_blur_px=motion_px,
        motion_blur_direction=direction,
        saturated_fraction=profiles.saturated,
        clipped_fraction=profiles.clipped,
        contrast=profiles.contrast if measurable else None,
        coverage_fraction=_coverage(points),
        tilt=_tilt(H, points),
        advice=(),
    )
    if not _is_motion(quality):
        quality = replace(quality, motion_blur_direction=None)
    elif _is_steep(H, points) or not _halves_agree(image, points, edges, cells, full):
        quality = replace(quality, motion_blur_px=None, motion_blur_direction=None)
    advice = advise(quality)
    if not measurable and profiles.is_wide:
        advice = (_SHARPNESS_NOT_MEASURABLE, *advice)
    return replace(quality, advice=advice)


@dataclass(frozen=True, slots=True)
class _Profiles:
    """Figures of the edges' profiles: each family's 10-90 % rise (px, NaN where it is not measurable), and the light.

    `is_wide` states that a sharp edge's rise would have been measurable.
    """

    rises: Float[np.ndarray, " families"]
    saturated: float | None
    clipped: float | None
    contrast: float | None
    is_wide: bool


def _average(image: Shaped[np.ndarray, "h w"], edges: Edges, full: float) -> _Profiles:
    """Average the edges with room enough for the widest: one whose ends are not yet black and white looks sharper."""
    room = np.ones(len(edges.family), dtype=np.bool_)
    widest = 0.0
    while True:
        averages, counts, ends, saturated, clipped = average_profiles(
            image,
            edges.middle[room],
            edges.across[room],
            edges.half_px[room],
            edges.family[room],
            edges.families,
            _MIN_CONTRAST * full,
            _TOP * full,
        )
        rises = np.array([_rise_px(average, count) for average, count in zip(averages, counts, strict=True)])
        few = np.bincount(edges.family[room], minlength=edges.families) < _MIN_PROFILES
        widest = max(
            widest, float(np.nanmax(rises, initial=0.0))
        )  # a family that was measured once still counts
        enough = room & ~(edges.straight_px < _MIN_REACH_RATIO * widest)
        if enough.sum() == room.sum():
            break
        room = enough
    rises[few] = math.nan
    seen = np.isfinite(ends[:, 0])
    return _Profiles(
        rises=rises,
        saturated=None if math.isnan(saturated) else float(saturated),
        clipped=None if math.isnan(clipped) else float(clipped),
        contrast=float(np.median(ends[seen, 1] - ends[seen, 0])) / full if seen.any() else None,
        is_wide=bool(np.median(edges.straight_px) > _MIN_REACH_RATIO * _SHARP_PX)
        if len(edges.family)
        else False,
    )


def _halves_agree(
    image: Shaped[np.ndarray, "h w"],
    points: GridPoints,
    edges: Edges,
    cells: Int[np.ndarray, "n 3"] | None,
    full: float,
) -> bool:
    """Return whether both halves of the edges show the same motion, which noise or a few odd edges do not."""
    found = []
    for half in range(2):
        some = np.arange(len(edges.family)) % 2 == half
        part = Edges(
            edges.middle[some],
            edges.across[some],
            edges.half_px[some],
            edges.straight_px[some],
            edges.family[some],
            edges.families,
        )
        length, direction = motion_of(
            blur_covariance(image, points, part, _average(image, part, full).rises, cells)
        )
        if length is None or direction is None:
            return False
        found.append(length**2 * np.array([math.cos(2.0 * direction), math.sin(2.0 * direction)]))
    return bool(np.linalg.norm(found[0] - found[1]) < _HALVES_DIFFER * np.linalg.norm(found[0] + found[1]))


def with_tilt(quality: CaptureQuality, tilt: float) -> CaptureQuality:
    """Return the quality with the tilt (rad) that a calibration found, in place of a usual lens's."""
    known = replace(quality, tilt=tilt)
    not_measurable = tuple(advisory for advisory in quality.advice if advisory == _SHARPNESS_NOT_MEASURABLE)
    return replace(known, advice=(*not_measurable, *advise(known)))


def _is_motion(quality: CaptureQuality) -> bool:
    """Return whether a blur is longer in one direction by more than is seen in the edges of an image at rest."""
    length, width = quality.motion_blur_px, quality.edge_width_px
    return length is not None and width is not None and length > max(_MOTION_PX, _MOTION_SHARE * width)


def _rise_px(average: Float[np.ndarray, " bins"], counts: Float[np.ndarray, " bins"]) -> float:
    """Return the 10-90 % rise distance of an average edge, NaN where it is not seen."""
    places = (np.arange(len(average)) + 0.5) / BINS_PER_PX - REACH_PX
    enough = counts > 0.2 * counts.max() if counts.max() > 0 else counts > 0
    s, g = places[enough], average[enough]
    if len(s) < 8:
        return math.nan
    zero = int(np.searchsorted(s, 0.0))
    low, high = _crossing(s[:zero][::-1], g[:zero][::-1], 0.1), _crossing(s[zero:], g[zero:], 0.9)
    return high - low


def _crossing(s: Float[np.ndarray, " n"], g: Float[np.ndarray, " n"], level: float) -> float:
    """Return where the edge, followed outward, first passes a level; NaN if never."""
    beyond = g < level if level < 0.5 else g > level
    if not beyond.any() or beyond[0]:
        return math.nan
    k = int(np.argmax(beyond))
    share = (level - g[k - 1]) / (g[k] - g[k - 1])
    return float(s[k - 1] + share * (s[k] - s[k - 1]))


def _coverage(points: GridPoints) -> float:
    """Return the fraction of the image within the grid points' outline."""
    outline = cv2.convexHull(points.points_px.astype(np.float32)).reshape(-1, 1, 2)
    return float(cv2.contourArea(outline)) / (points.image_width_px * points.image_height_px)


def _plane(points: GridPoints) -> Float[np.ndarray, "3 3"]:
    """Return the map from the target's plane (mm) to pixels, about the image's centre."""
    few = thinned(np.arange(len(points)))
    H = find_homography(points.points_target[few, :2], points.points_px[few] - _middle_px(points))
    if H is None:
        raise DegenerateGeometry("The grid points found lie on a line.", points=points)
    return H


def _middle_px(points: GridPoints) -> Float[np.ndarray, "2"]:
    return 0.5 * np.array([points.image_width_px - 1.0, points.image_height_px - 1.0])


def _is_steep(H: Float[np.ndarray, "3 3"], points: GridPoints) -> bool:
    """Return whether the target is so short in one direction that its edges there are no measure of blur."""
    long, short = np.linalg.svd(local_map(H, points.points_target.mean(axis=0)[None])[0], compute_uv=False)
    return bool(short < _MIN_SHORTENED * long)


def _tilt(H: Float[np.ndarray, "3 3"], points: GridPoints) -> float | None:
    """Return the angle between the target's normal and the optical axis, for a focal length of one image width."""
    x, y = (H[:, k] / [points.image_width_px, points.image_width_px, 1.0] for k in range(2))
    normal = np.cross(x, y)
    length = float(np.linalg.norm(normal))
    return math.acos(min(1.0, abs(float(normal[2])) / length)) if length > 0.0 else None
