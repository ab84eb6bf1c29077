"""The quality of an image for measurement: a value stored with the grid points."""

from __future__ import annotations

from dataclasses import dataclass

from core.errors import Advisory


@dataclass(frozen=True, slots=True)
class CaptureQuality:
    """Figures of an image at the target; each is None where the image does not determine it.

    `edge_width_px` is the 10-90 % rise distance of the sharpest edges; `motion_blur_px` the length of a uniform
    motion that would widen edges as much more in one direction than in the other, and `motion_blur_direction` that
    direction, rad from +u toward +v, in [0, π), where it is more than images at rest show. `saturated_fraction` is
    how much of the target's white is at the sensor's top, `clipped_fraction` how much of its black at the bottom;
    `contrast` is white less black, as a fraction of full scale; `coverage_fraction` how much of the image lies within
    the grid points' outline; `tilt` (rad) the angle between the target's normal and the optical axis: by the
    calibration, or without one for a focal length of one image width. `advice` holds what would make a
    better image, the most effective first; empty for a good one.
    """

    edge_width_px: float | None
    motion_blur_px: float | None
    motion_blur_direction: float | None
    saturated_fraction: float | None
    clipped_fraction: float | None
    contrast: float | None
    coverage_fraction: float
    tilt: float | None
    advice: tuple[Advisory, ...]
