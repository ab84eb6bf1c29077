"""What an overlay shows, as plain values; places are pixels of the original image."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, UInt8

Verdict = Literal["measured", "refused", "waiting"]


@dataclass(frozen=True, slots=True)
class Points:
    """Grid points found.

    `residuals_px` (n, 2) are observed - predicted, NaN where no fit looked at a point; `used` is whether the fit kept
    it, `judged` whether one looked at it.
    """

    places_px: Float[np.ndarray, "n 2"]
    residuals_px: Float[np.ndarray, "n 2"]
    used: Bool[np.ndarray, " n"]
    judged: Bool[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.places_px)


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis of the target frame: its letter and where it begins and ends in the image."""

    name: Literal["x", "y", "z"]
    start_px: tuple[float, float]
    end_px: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Statement:
    """What is said below the image: a title, sentences, and figures in a smaller type."""

    verdict: Verdict
    title: str
    sentences: tuple[str, ...] = ()
    figures: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class OverlayContent:
    """An image and what was seen in it.

    `grey` is the image, reduced or not, of `image_width_px` by `image_height_px`; `candidates_px` are places that look
    like grid points of a target that was not found.
    """

    grey: UInt8[np.ndarray, "h w"]
    image_width_px: int
    image_height_px: int
    statement: Statement
    points: Points | None = None
    axes: tuple[Axis, ...] = ()
    candidates_px: Float[np.ndarray, "m 2"] = field(default_factory=lambda: np.zeros((0, 2)))
