"""Finding dots: patches darker or brighter than what is around them that are ellipses.

A picture is compared with its own local mean at several scales, so that a dot is cut out whatever the light. Of each
patch the moments give centre and ellipse; what is no ellipse is dropped. A dot found at several scales is
taken once, where it looks most like one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.spatial import cKDTree

from core.compiled import compiled
from core.targets.pyramid import Level

_WINDOWS = (0.04, 0.12)  # of the longer side: over what the local mean is taken
_LEAST_AREA_PX = 18.0
_LARGEST_AREA = 0.05  # of the picture
_LEAST_STEP = 0.04  # of the picture's range of grey levels
_MOST_SLENDER = 6.0  # long over short axis
_LEAST_FILL = 0.25  # of its bounding box
_ELLIPTIC = 0.03  # by how much the area may differ from that of the ellipse with the same moments
_PER_PIXEL = 0.6  # and how much more for a patch of a few pixels, times the root of its area
_SAME = 0.35  # of the radius: centres nearer than that are one dot


@dataclass(frozen=True, slots=True)
class Dots:
    """Dots in pixels of one level: centres, and the second moments of uniform ellipses (px², a circle's is r²/4)."""

    centres: Float[np.ndarray, "n 2"]
    moments: Float[np.ndarray, "n 2 2"]
    are_dark: bool

    def __len__(self) -> int:
        return len(self.centres)


def find_dots(level: Level) -> Iterator[Dots]:
    """Yield the dark dots of a level, and the bright ones."""
    image = _eight_bit(level.image)
    low, high = np.percentile(image[::4, ::4], [1.0, 99.0])
    step = max(2.0, _LEAST_STEP * float(high - low))
    masks: dict[bool, list[Shaped[np.ndarray, "h w"]]] = {True: [], False: []}
    for share in _WINDOWS:
        width = 2 * round(0.5 * share * max(image.shape)) + 1
        mean = cv2.blur(image, (width, width), borderType=cv2.BORDER_REPLICATE)
        masks[True].append((cv2.subtract(mean, image) > step).view(np.uint8))
        masks[False].append((cv2.subtract(image, mean) > step).view(np.uint8))
    for are_dark, found in masks.items():
        yield _ellipses(found, are_dark)


def _eight_bit(image: Shaped[np.ndarray, "h w"]) -> Shaped[np.ndarray, "h w"]:
    if image.dtype == np.uint8:
        return image
    low, high = int(image.min()), int(image.max())
    return np.asarray(((image - low) * (255.0 / max(high - low, 1))).astype(np.uint8))


def _ellipses(masks: list[Shaped[np.ndarray, "h w"]], are_dark: bool) -> Dots:
    parts = [_patches(mask) for mask in masks]
    centres, moments, misfits = (np.concatenate(values) for values in zip(*parts, strict=True))
    kept = _once(centres, moments, misfits)
    return Dots(centres[kept], moments[kept], are_dark)


def _patches(
    mask: Shaped[np.ndarray, "h w"],
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"], Float[np.ndarray, " n"]]:
    """Return centres, moments and misfits of a mask's patches that are ellipses."""
    _, labels, statistics, centres = cv2.connectedComponentsWithStats(mask, connectivity=4, ltype=cv2.CV_32S)
    area = statistics[:, cv2.CC_STAT_AREA].astype(np.float64)
    box = statistics[:, cv2.CC_STAT_WIDTH].astype(np.float64) * statistics[:, cv2.CC_STAT_HEIGHT]
    wanted = (area >= _LEAST_AREA_PX) & (area <= _LARGEST_AREA * mask.size) & (area > _LEAST_FILL * box)
    wanted[0] = False
    chosen = np.flatnonzero(wanted)
    if len(chosen) == 0:
        return np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0)
    second = patch_moments(labels, statistics[chosen, :4], chosen.astype(np.int32), centres[chosen])
    area = area[chosen]
    C = second / area[:, None, None]
    determinant = C[:, 0, 0] * C[:, 1, 1] - C[:, 0, 1] ** 2
    middle = 0.5 * (C[:, 0, 0] + C[:, 1, 1])
    spread = np.sqrt(np.maximum(middle**2 - determinant, 0.0))
    least = middle - spread
    slender = middle + spread > _MOST_SLENDER**2 * least
    sound = (least > 0.0) & ~slender
    misfit = np.abs(area / (4.0 * np.pi * np.sqrt(np.where(sound, determinant, 1.0))) - 1.0)
    fits = sound & (misfit < _ELLIPTIC + _PER_PIXEL / np.sqrt(area))
    return centres[chosen][fits], C[fits], misfit[fits]


@compiled
def patch_moments(
    labels: Int[np.ndarray, "h w"],
    boxes: Int[np.ndarray, "n 4"],
    chosen: Int[np.ndarray, " n"],
    centres: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n 2 2"]:
    """Return the sums of (u - ū)(u - ū)ᵀ over the pixels of labelled patches; boxes are left, top, width, height.

    A pixel is a square: its own 1/12 is part of the patch's.
    """
    sums = np.zeros((len(chosen), 2, 2))
    for n in range(len(chosen)):
        left, top, width, height = boxes[n, 0], boxes[n, 1], boxes[n, 2], boxes[n, 3]
        uu, uv, vv, count = 0.0, 0.0, 0.0, 0
        for v in range(top, top + height):
            y = v - centres[n, 1]
            for u in range(left, left + width):
                if labels[v, u] == chosen[n]:
                    x = u - centres[n, 0]
                    uu += x * x
                    uv += x * y
                    vv += y * y
                    count += 1
        sums[n, 0, 0] = uu + count / 12.0
        sums[n, 1, 1] = vv + count / 12.0
        sums[n, 0, 1] = sums[n, 1, 0] = uv
    return sums


def _once(
    centres: Float[np.ndarray, "n 2"], moments: Float[np.ndarray, "n 2 2"], misfits: Float[np.ndarray, " n"]
) -> Int[np.ndarray, " k"]:
    """Return which patches to keep: of those at one place the one that is most nearly an ellipse."""
    if len(centres) < 2:
        return np.arange(len(centres))
    radius = 2.0 * np.linalg.det(moments) ** 0.25
    pairs = cKDTree(centres).query_pairs(_SAME * float(radius.max()), output_type="ndarray")
    apart = np.hypot(*(centres[pairs[:, 0]] - centres[pairs[:, 1]]).T)
    pairs = pairs[apart < _SAME * np.minimum(radius[pairs[:, 0]], radius[pairs[:, 1]])]
    kept: Bool[np.ndarray, " n"] = np.ones(len(centres), dtype=np.bool_)
    order = np.lexsort((pairs[:, 1], pairs[:, 0], misfits[pairs].min(axis=1)))
    for first, second in pairs[order].tolist():
        if kept[first] and kept[second]:
            kept[first if (misfits[first], first) > (misfits[second], second) else second] = False
    return np.flatnonzero(kept)
