"""Grey levels of an image: sampled between pixels or at them, and the level at which its camera cuts off white."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, Shaped

_BIT_DEPTHS = (10, 12, 14, 16)
_MAX_REMAP_ROWS = 32_000  # OpenCV raises from 2¹⁵ - 1 rows on


def largest_level(image: Shaped[np.ndarray, "h w"]) -> float:
    """Return the level at which an image's camera cuts off white; 16 bits may hold 10, 12 or 14, at either end."""
    if image.dtype == np.uint8:
        return 255.0
    largest = int(image.max())
    ends = {((1 << bits) - 1) << shift for bits in _BIT_DEPTHS for shift in (0, 16 - bits)}
    return float(largest) if largest in ends else 65535.0


def levels_between(
    image: Shaped[np.ndarray, "h w"], u: Float[np.ndarray, "n k"], v: Float[np.ndarray, "n k"]
) -> Float[np.ndarray, "n k"]:
    """Return the levels at places (px), bilinear between pixels; beyond the image's border those at the border."""
    levels = np.empty(u.shape)
    for first in range(0, len(u), _MAX_REMAP_ROWS):
        rows = slice(first, first + _MAX_REMAP_ROWS)
        at = u[rows].astype(np.float32), v[rows].astype(np.float32)
        levels[rows] = cv2.remap(image, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return levels


def nearest_levels(
    image: Shaped[np.ndarray, "h w"], places_px: Float[np.ndarray, "n 2"], reach: int = 0
) -> Float[np.ndarray, " n"]:
    """Return the mean of the pixels within `reach` columns and rows of the one nearest to each place; NaN where these
    are not all in the image.
    """
    levels = np.full(len(places_px), np.nan)
    last = np.array(image.shape[::-1]) - 1.0 - reach
    inside = np.all((places_px >= reach) & (places_px <= last), axis=1)  # NaN is not
    u, v = np.rint(places_px[inside]).astype(np.intp).T
    around = np.arange(-reach, reach + 1)
    levels[inside] = image[v[:, None, None] + around[:, None], u[:, None, None] + around].mean(axis=(1, 2))
    return levels
