"""Finding dots: patches darker or brighter than what is around them that are ellipses.

An image is compared with its own local mean at several scales, so that a dot is segmented under any light. Of each
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

from core.jit import jit
from core.targets.lattice import Level

_WINDOWS = (0.04, 0.12)  # of the longer side: over what the local mean is taken
_MIN_AREA_PX = 18.0
_MAX_AREA = 0.05  # of the image
_MIN_STEP = 0.04  # of the image's range of grey levels
_MAX_SLENDER = 6.0  # long over short axis
_MIN_FILL = 0.25  # of its bounding box
_ELLIPTIC = 0.03  # by how much the area may differ from that of the ellipse with the same moments
_PER_PIXEL = 0.6  # and how much more for a patch of a few pixels, times the root of its area
_SAME = 0.35  # of the radius: centres nearer than that are one dot


@dataclass(frozen=True, slots=True)
class Dots:
    """Dots in pixels of one level: centres, and the second moments of uniform ellipses (px², a circle's is r²/4).

    `fill` is their area over that of the ellipse with the same moments: of a square and its like .955.
    """

    centres: Float[np.ndarray, "n 2"]
    moments: Float[np.ndarray, "n 2 2"]
    fill: Float[np.ndarray, " n"]
    are_dark: bool

    def __len__(self) -> int:
        return len(self.centres)


def find_dots(level: Level) -> Iterator[Dots]:
    """Yield the dark dots of a level, and the bright ones."""
    image = _eight_bit(level.image)
    low, high = np.percentile(image[::4, ::4], [1.0, 99.0])
    step = max(2.0, _MIN_STEP * float(high - low))
    means = []
    for share in _WINDOWS:
        width = 2 * round(0.5 * share * max(image.shape)) + 1
        means.append(cv2.blur(image, (width, width), borderType=cv2.BORDER_REPLICATE))
    yield _ellipses([(cv2.subtract(mean, image) > step).view(np.uint8) for mean in means], are_dark=True)
    yield _ellipses([(cv2.subtract(image, mean) > step).view(np.uint8) for mean in means], are_dark=False)


def _eight_bit(image: Shaped[np.ndarray, "h w"]) -> Shaped[np.ndarray, "h w"]:
    if image.dtype == np.uint8:
        return image
    low, high = int(image.min()), int(image.max())
    return np.asarray(((image - low) * (255.0 / max(high - low, 1))).astype(np.uint8))


def _ellipses(masks: list[Shaped[np.ndarray, "h w"]], *, are_dark: bool) -> Dots:
    parts = [_patches(mask) for mask in masks]
    centres, moments, fill = (np.concatenate(values) for values in zip(*parts, strict=True))
    kept = _once(centres, moments, np.abs(fill - 1.0))
    return Dots(centres[kept], moments[kept], fill[kept], are_dark)


def _patches(
    mask: Shaped[np.ndarray, "h w"],
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"], Float[np.ndarray, " n"]]:
    """Return centres, moments and fill of a mask's patches that are ellipses."""
    area, boxes, centres, second = patches(mask)
    box = (boxes[:, 2] * boxes[:, 3]).astype(np.float64)
    wanted = (area >= _MIN_AREA_PX) & (area <= _MAX_AREA * mask.size) & (area > _MIN_FILL * box)
    chosen = np.flatnonzero(wanted)
    if len(chosen) == 0:
        return np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0)
    area = area[chosen]
    C = second[chosen] / area[:, None, None]
    determinant = C[:, 0, 0] * C[:, 1, 1] - C[:, 0, 1] ** 2
    middle = 0.5 * (C[:, 0, 0] + C[:, 1, 1])
    spread = np.sqrt(np.maximum(middle**2 - determinant, 0.0))
    least = middle - spread
    slender = middle + spread > _MAX_SLENDER**2 * least
    sound = (least > 0.0) & ~slender
    fill = area / (4.0 * np.pi * np.sqrt(np.where(sound, determinant, 1.0)))
    fits = sound & (np.abs(fill - 1.0) < _ELLIPTIC + _PER_PIXEL / np.sqrt(area))
    return centres[chosen][fits], C[fits], fill[fits]


@jit("u1[:, ::1]")
def patches(
    mask: Shaped[np.ndarray, "h w"],
) -> tuple[
    Float[np.ndarray, " n"], Int[np.ndarray, "n 4"], Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"]
]:
    """Return area, box (left, top, width, height), centre and the sums of (u - ū)(u - ū)ᵀ of a mask's patches: pixels
    that are not 0, joined by their sides, in the order in which a row-wise look meets them.

    A pixel is a square: its own 1/12 is part of the patch's moments. Runs of pixels along the rows are joined where
    they touch those of the row before.
    """
    height, width = mask.shape
    runs = 0
    for v in range(height):
        before = 0
        for u in range(width):
            runs += (mask[v, u] != 0) and before == 0
            before = mask[v, u]
    first, last = np.empty(runs, dtype=np.int64), np.empty(runs, dtype=np.int64)
    row, parent = np.empty(runs, dtype=np.int64), np.empty(runs, dtype=np.int64)
    count, above, above_end = 0, 0, 0
    for v in range(height):
        begun = count
        u = 0
        while u < width:
            if mask[v, u] == 0:
                u += 1
                continue
            first[count], row[count], parent[count] = u, v, count
            while u < width and mask[v, u] != 0:
                u += 1
            last[count] = u - 1
            count += 1
        k = above
        for n in range(begun, count):
            while k < above_end and last[k] < first[n]:
                k += 1
            m = k
            while m < above_end and first[m] <= last[n]:
                a, b = n, m
                while parent[a] != a:
                    parent[a] = parent[parent[a]]
                    a = parent[a]
                while parent[b] != b:
                    parent[b] = parent[parent[b]]
                    b = parent[b]
                if a < b:
                    parent[b] = a
                else:
                    parent[a] = b
                m += 1
        above, above_end = begun, count
    number = np.empty(runs, dtype=np.int64)
    found = 0
    for n in range(runs):  # a run's root comes before it
        root = n
        while parent[root] != root:
            root = parent[root]
        if root == n:
            number[n] = found
            found += 1
        else:
            number[n] = number[root]
    area, boxes = np.zeros(found), np.zeros((found, 4), dtype=np.int64)
    centres, second = np.zeros((found, 2)), np.zeros((found, 2, 2))
    for n in range(runs):
        i, a, b, v = number[n], first[n], last[n], row[n]
        length = b - a + 1
        if area[i] == 0.0:
            boxes[i, 0], boxes[i, 1], boxes[i, 2] = a, v, b
        boxes[i, 0], boxes[i, 2], boxes[i, 3] = min(boxes[i, 0], a), max(boxes[i, 2], b), v
        area[i] += length
        centres[i, 0] += 0.5 * length * (a + b)
        centres[i, 1] += length * v
    for i in range(found):
        centres[i, 0] /= area[i]
        centres[i, 1] /= area[i]
        boxes[i, 2] += 1 - boxes[i, 0]
        boxes[i, 3] += 1 - boxes[i, 1]
    for n in range(runs):
        i, length = number[n], last[n] - first[n] + 1
        x, y = 0.5 * (first[n] + last[n]) - centres[i, 0], row[n] - centres[i, 1]
        # a run of so many squares is length³ / 12 about its middle
        second[i, 0, 0] += length * (x * x + length * length / 12.0)
        second[i, 1, 1] += length * (y * y + 1.0 / 12.0)
        second[i, 0, 1] += length * x * y
    for i in range(found):
        second[i, 1, 0] = second[i, 0, 1]
    return area, boxes, centres, second


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
