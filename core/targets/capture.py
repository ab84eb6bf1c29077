"""How well a picture was taken: sharpness, motion, light, size and tilt, from the target's own edges.

**Blur.** Each edge of the target is a step before the lens and the motion blurred it. Across an edge with the normal n
the blur of covariance Σ (px²) has the variance nᵀ Σ n, read from the average edge's 10-90 % rise distance. The edges of
a chessboard have but two directions m₁, m₂, which leave Σ's third element open; the corners tell it. Where the edges
cross the grey value is, of the contrast's half above the middle,

    E[sgn(m₁ᵀ z) sgn(m₂ᵀ z)] = (2/π) arcsin(m₁ᵀ Σ m₂ / √(m₁ᵀ Σ m₁ · m₂ᵀ Σ m₂)),   z ~ N(0, Σ)

(Sheppard's formula). Around a dot there are edges of all directions. A uniform motion of length L adds L²/12 along its
direction, so that L² = 12 (λ₁ - λ₂) with Σ's eigenvalues λ.

**Light.** The ends of the same profiles lie on the target's white and black.

References: ISO 12233 for the edge profile; W. F. Sheppard, "On the application of the theory of error to cases of
normal distribution and normal correlation", Phil. Trans. R. Soc. A 192 (1899), 10.1098/rsta.1899.0003.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, Int, Shaped

from core.errors import Advisory, DegenerateGeometry
from core.targets.capture_advice import advise
from core.targets.capture_edges import (
    Edges,
    dot_edges,
    free_of_marker,
    local_map,
    normals,
    square_corners,
    square_edges,
    thinned,
)
from core.targets.capture_quality import CaptureQuality
from core.targets.edge_kernel import BINS_PER_PX, REACH_PX, average_profiles
from core.targets.specification import GridPoints

_ENOUGH_REACH = 1.5  # of the rise distance: nearer ends of an edge are not yet black and white
_LEAST_CONTRAST = 0.03  # of full scale, of an edge that is looked at
_LEAST_PROFILES = 4  # of a family
_SHARP_PX = 3.0  # the 10-90 % rise of a sharp picture's edge
_HALVES_DIFFER = 0.25
_LEAST_SHORTENED = 0.45  # of the longer side of a square, a tilt of 63°: beyond it motion is not told
_GAUSSIAN_RISE = 2.563  # 10-90 % of a Gaussian's rise, standard deviations
_TOP = 0.995  # of full scale

_MOTION_PX, _MOTION_SHARE = 2.0, 0.8  # the latter of the edges' width


_UNTOLD = Advisory(
    "sharpness_untold",
    "The target's edges are too wide, or the target too small in the picture, to tell how sharp they are.",
    "Focus on the target and keep it at rest; if the picture looks sharp, come nearer or take larger squares.",
)


def assess_capture(image: Shaped[np.ndarray, "h w"], points: GridPoints) -> CaptureQuality:
    """Tell how well a picture (grey, uint8 or uint16) was taken, where `points` were found in it."""
    full = 255.0 if image.dtype == np.uint8 else 65535.0
    is_dots = points.target.kind in ("circles", "asymmetric_circles")
    cells = None if is_dots else square_corners(points)
    H = _plane(points)
    edges = dot_edges(points, H) if cells is None else square_edges(points, cells)
    profiles = _average(image, edges, full)
    motion_px, direction = _motion(_blur(image, points, edges, profiles.rises, cells))
    told = np.isfinite(profiles.rises).any()
    quality = CaptureQuality(
        edge_width_px=float(np.nanmin(profiles.rises)) if told else None,
        motion_blur_px=motion_px,
        motion_blur_direction=direction,
        saturated_fraction=profiles.saturated,
        clipped_fraction=profiles.clipped,
        contrast=profiles.contrast if told else None,
        coverage_fraction=_coverage(points),
        tilt=_tilt(H, points),
        advice=(),
    )
    if not _is_motion(quality):
        quality = replace(quality, motion_blur_direction=None)
    elif _is_steep(H, points) or not _halves_agree(image, points, edges, cells, full):
        quality = replace(quality, motion_blur_px=None, motion_blur_direction=None)
    advice = advise(quality)
    if not told and profiles.is_wide:
        advice = (_UNTOLD, *advice)
    return replace(quality, advice=advice)


@dataclass(frozen=True, slots=True)
class _Profiles:
    """What the edges' profiles say: each family's 10-90 % rise (px, NaN where it is not told), and the light.

    `is_wide` tells that a sharp edge's rise would have been told.
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
            _LEAST_CONTRAST * full,
            _TOP * full,
        )
        rises = np.array([_rise_px(average, count) for average, count in zip(averages, counts, strict=True)])
        few = np.bincount(edges.family[room], minlength=edges.families) < _LEAST_PROFILES
        widest = max(widest, float(np.nanmax(rises, initial=0.0)))  # a family that was told once still counts
        enough = room & ~(edges.straight_px < _ENOUGH_REACH * widest)
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
        is_wide=bool(np.median(edges.straight_px) > _ENOUGH_REACH * _SHARP_PX)
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
    """Tell whether either half of the edges shows the same motion: what noise or a few odd edges make, they do not."""
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
        length, direction = _motion(_blur(image, points, part, _average(image, part, full).rises, cells))
        if length is None or direction is None:
            return False
        found.append(length**2 * np.array([math.cos(2.0 * direction), math.sin(2.0 * direction)]))
    return bool(np.linalg.norm(found[0] - found[1]) < _HALVES_DIFFER * np.linalg.norm(found[0] + found[1]))


def with_tilt(quality: CaptureQuality, tilt: float) -> CaptureQuality:
    """Return the quality with the tilt (rad) that a calibration found, in place of a usual lens's."""
    known = replace(quality, tilt=tilt)
    untold = tuple(remark for remark in quality.advice if remark == _UNTOLD)
    return replace(known, advice=(*untold, *advise(known)))


def _is_motion(quality: CaptureQuality) -> bool:
    """Tell whether a blur that is longer one way is so by more than the edges of a picture at rest seem to be."""
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


def _blur(
    image: Shaped[np.ndarray, "h w"],
    points: GridPoints,
    edges: Edges,
    rises: Float[np.ndarray, " families"],
    cells: Int[np.ndarray, "n 3"] | None,
) -> Float[np.ndarray, "2 2"] | None:
    """Return the blur's covariance, px²; None where the edges do not tell it."""
    rows, values = [], []
    for number in range(edges.families):
        n = edges.across[edges.family == number]
        if len(n) and math.isfinite(rises[number]):
            rows.append(_quadratic(n, n))
            values.append((rises[number] / _GAUSSIAN_RISE) ** 2)
    if cells is not None and len(rows) == 2:
        crossing = _crossing_correlation(image, points, cells)
        if crossing is None:
            return None
        m1, m2, correlation = crossing
        rows.append(_quadratic(m1, m2))
        values.append(correlation * math.sqrt(values[0] * values[1]))
    if len(rows) < 3:
        return None
    (uu, uv, vv), _, rank, _ = np.linalg.lstsq(np.array(rows), np.array(values), rcond=1e-3)
    return np.array([[uu, uv], [uv, vv]]) if rank == 3 else None


def _quadratic(m: Float[np.ndarray, "n 2"], n: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3"]:
    """Return the mean of mᵀ Σ n as a row over Σ's elements uu, uv, vv."""
    return np.array(
        [
            np.mean(m[:, 0] * n[:, 0]),
            np.mean(m[:, 0] * n[:, 1] + m[:, 1] * n[:, 0]),
            np.mean(m[:, 1] * n[:, 1]),
        ]
    )


def _crossing_correlation(
    image: Shaped[np.ndarray, "h w"], points: GridPoints, cells: Int[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m 2"], float] | None:
    """Return the normals of the two edges at corners, and the blur's correlation between them."""
    few = cells[thinned(np.arange(len(cells)))]
    start, along, down = (points.points_px[few[:, k]] for k in range(3))
    a, b = along - start, down - start
    m1, m2 = normals(a), normals(b)
    m1 *= np.sign((m1 * b).sum(axis=1, keepdims=True))
    m2 *= np.sign((m2 * a).sum(axis=1, keepdims=True))
    far = 0.8 * free_of_marker(points)
    places = np.stack(
        [start] + [start + far * (i * a + j * b) for i, j in ((1, 1), (-1, -1), (1, -1), (-1, 1))]
    )
    u, v = np.ascontiguousarray(places.astype(np.float32).transpose(2, 0, 1))
    grey = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float64)
    same, other = 0.5 * (grey[1] + grey[2]), 0.5 * (grey[3] + grey[4])
    swing = 0.5 * (same - other)
    clear = np.abs(swing) > 0.25 * np.median(np.abs(swing))
    if not clear.any():
        return None
    value = float(np.median((grey[0] - 0.5 * (same + other))[clear] / swing[clear]))
    return m1, m2, math.sin(0.5 * math.pi * min(max(value, -1.0), 1.0))


def _motion(blur: Float[np.ndarray, "2 2"] | None) -> tuple[float | None, float | None]:
    """Return length (px) and direction (rad) of the motion that would explain a blur longer one way."""
    if blur is None:
        return None, None
    variances, directions = np.linalg.eigh(blur)
    length = math.sqrt(12.0 * max(0.0, float(variances[1] - max(variances[0], 0.0))))
    u, v = directions[:, 1]
    return length, math.atan2(v, u) % math.pi


def _coverage(points: GridPoints) -> float:
    """Return how much of the picture lies within the grid points' outline."""
    outline = cv2.convexHull(points.points_px.astype(np.float32)).reshape(-1, 1, 2)
    return float(cv2.contourArea(outline)) / (points.image_width_px * points.image_height_px)


def _plane(points: GridPoints) -> Float[np.ndarray, "3 3"]:
    """Return the map from the target's plane (mm) to pixels, about the picture's middle."""
    few = thinned(np.arange(len(points)))
    H, _ = cv2.findHomography(points.points_target[few, :2], points.points_px[few] - _middle_px(points))
    if H is None or not np.all(np.isfinite(H)):
        raise DegenerateGeometry("The grid points found lie on a line.", points=points)
    return np.asarray(H)


def _middle_px(points: GridPoints) -> Float[np.ndarray, "2"]:
    return 0.5 * np.array([points.image_width_px - 1.0, points.image_height_px - 1.0])


def _is_steep(H: Float[np.ndarray, "3 3"], points: GridPoints) -> bool:
    """Tell whether the target is so short in one direction that its edges there are no measure of blur."""
    long, short = np.linalg.svd(local_map(H, points.points_target.mean(axis=0)[None])[0], compute_uv=False)
    return bool(short < _LEAST_SHORTENED * long)


def _tilt(H: Float[np.ndarray, "3 3"], points: GridPoints) -> float | None:
    """Return the angle between the target's normal and the optical axis, for a lens as long as the picture is wide."""
    x, y = (H[:, k] / [points.image_width_px, points.image_width_px, 1.0] for k in range(2))
    normal = np.cross(x, y)
    length = float(np.linalg.norm(normal))
    return math.acos(min(1.0, abs(float(normal[2])) / length)) if length > 0.0 else None
