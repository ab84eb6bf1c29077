"""How well a picture was taken, for measuring: a value that travels with the grid points."""

from __future__ import annotations

from dataclasses import dataclass

from core.errors import Advisory


@dataclass(frozen=True, slots=True)
class CaptureQuality:
    """What a picture is like where the target is; each figure None where the picture does not tell it.

    `edge_width_px` is the 10-90 % rise distance of the sharpest edges; `motion_blur_px` the length of a uniform
    motion that would widen edges as much more in one direction than in the other, and `motion_blur_direction` that
    direction, rad from +u toward +v, in [0, π), where it is more than pictures at rest show. `saturated_fraction` is
    how much of the target's white is at the sensor's top, `clipped_fraction` how much of its black at the bottom;
    `contrast` is white less black, as a fraction of full scale; `coverage_fraction` how much of the picture lies within
    the grid points' outline; `tilt` (rad) the angle between the target's normal and the optical axis: by the
    calibration, or where there is none for a lens as long as the picture is wide. `advice` holds what would make a
    better picture, the most worthwhile first; empty for a good one.
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
