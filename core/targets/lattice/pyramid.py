"""An image pyramid: each level holds the means of two by two pixels of the one before.

Halving twice costs a twentieth of one area-weighted reduction by four, and where pixels lie stays exact.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Shaped

_COARSEST_PX = 700  # longest side of the level looked at first
_SMALL_PIXELS = 1_600_000  # up to this size full resolution is looked at as well
_MOST_DOUBLED = 8_000_000  # pixels of the largest image that is doubled


@dataclass(frozen=True, slots=True)
class Level:
    """An image reduced by 2^halvings, or doubled with -1, grey values of the same type as the full one's."""

    image: Shaped[np.ndarray, "h w"]
    halvings: int

    def to_full(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Return places of this level as pixels of the full image: full = (small + ½) 2^halvings - ½."""
        scale = 2.0**self.halvings
        return (points.astype(np.float64) + 0.5) * scale - 0.5


def levels(image: Shaped[np.ndarray, "h w"]) -> Iterator[Level]:
    """Yield the levels on which a board is looked for, coarse to fine.

    The finest is the half of a large image: squares of 8 px are 4 px there, enough to detect their corners.
    """
    finest = 0 if image.size <= _SMALL_PIXELS else 1
    for level in reversed(_halved(image)):
        if level.halvings >= finest:
            yield level


def blurred_levels(image: Shaped[np.ndarray, "h w"]) -> Iterator[Level]:
    """Yield the level beyond those of `levels`, for corners of large squares that motion has blurred: along a square's
    diagonal it joins two squares of one colour to a ridge as long as itself, in which a fine level has no saddle."""
    smaller = _half(_halved(image)[-1])
    if smaller is not None:
        yield smaller


def fine_levels(image: Shaped[np.ndarray, "h w"]) -> Iterator[Level]:
    """Yield the levels beyond those of `levels`, for squares with print near their edges: the image itself where these
    end before it, and the image doubled, on which a saddle does not merge with one that is 2 px away."""
    if image.size > _SMALL_PIXELS:
        yield Level(image, 0)
    if image.size <= _MOST_DOUBLED:
        yield Level(cv2.resize(image, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC), -1)


def _halved(image: Shaped[np.ndarray, "h w"]) -> list[Level]:
    """Return the image and its halves, fine to coarse."""
    halved = [Level(image, 0)]
    while halved[-1].halvings < 1 or max(halved[-1].image.shape) > _COARSEST_PX:
        smaller = _half(halved[-1])
        if smaller is None:
            break
        halved.append(smaller)
    return halved


def _half(level: Level) -> Level | None:
    """Return a level at half its size; None of a single row or column."""
    height, width = level.image.shape[0] // 2, level.image.shape[1] // 2
    if min(height, width) < 1:
        return None
    even = level.image[: 2 * height, : 2 * width]
    return Level(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA), level.halvings + 1)
