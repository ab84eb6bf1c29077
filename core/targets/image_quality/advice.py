"""Advice for a better image, derived from the figures of its quality."""

from __future__ import annotations

import math

from core.errors import ADVISED_TILT, Advisory
from core.targets.quality_result import CaptureQuality

_BLUR_PX = 4.5
_SATURATED = 0.02
_CLIPPED = 0.2
_CONTRAST = 0.2
_COVERAGE = 0.1
_TILT_LOW, _TILT_HIGH = math.radians(15.0), math.radians(60.0)


def advise(quality: CaptureQuality) -> tuple[Advisory, ...]:
    """Return advice for a better image, the most effective first."""
    said: list[Advisory] = []
    q = quality
    if q.saturated_fraction is not None and q.saturated_fraction > _SATURATED:
        said.append(
            Advisory(
                "overexposed",
                f"{q.saturated_fraction:.0%} of the target's white is saturated, which moves its edges.",
                "Expose less, close the aperture a little, or turn the light away.",
            )
        )
    if q.motion_blur_px is not None and q.motion_blur_direction is not None:
        said.append(
            Advisory(
                "motion_blur",
                f"Something moved while the image was exposed: about {q.motion_blur_px:.1f} px along "
                f"{math.degrees(q.motion_blur_direction):.0f}° (0° is to the right, 90° down).",
                "Wait until the robot rests before the image is taken, or expose for a shorter time.",
            )
        )
    if q.edge_width_px is not None and q.edge_width_px > _BLUR_PX:
        said.append(
            Advisory(
                "blurred",
                f"The edges are {q.edge_width_px:.1f} px wide (10-90 %); 2 to 4 px are good.",
                "Focus on the target, or close the aperture for more depth of field.",
            )
        )
    if q.contrast is not None and q.contrast < _CONTRAST:
        said.append(
            Advisory(
                "low_contrast",
                f"Between the target's black and white lie {q.contrast:.0%} of the camera's range.",
                "Expose longer or light the target better, without reflections on it.",
            )
        )
    if q.clipped_fraction is not None and q.clipped_fraction > _CLIPPED:
        said.append(
            Advisory(
                "underexposed",
                f"{q.clipped_fraction:.0%} of the target's black is at zero, which moves its edges.",
                "Expose longer, or raise the camera's black level.",
            )
        )
    if q.tilt is not None and q.tilt < _TILT_LOW:
        degrees = math.degrees(q.tilt)
        said.append(
            Advisory(
                "tilt_too_small",
                f"The target is tilted by {degrees:.0f}°: a single image like this determines the focal length poorly.",
                f"Tilt the target or the camera {30.0 - degrees:.0f}° more ({ADVISED_TILT} are best), unless the "
                "session's lens is known.",
            )
        )
    if q.tilt is not None and q.tilt > _TILT_HIGH:
        degrees = math.degrees(q.tilt)
        said.append(
            Advisory(
                "tilt_too_large",
                f"The target is tilted by {degrees:.0f}°: its squares are short in one direction.",
                f"Tilt it {max(1.0, degrees - 45.0):.0f}° less; {ADVISED_TILT} are best.",
            )
        )
    if q.coverage_fraction < _COVERAGE:
        said.append(
            Advisory(
                "low_image_coverage",
                f"The grid fills {q.coverage_fraction:.0%} of the image.",
                "Come nearer, or use a larger target: a third of the image and more is good.",
            )
        )
    return tuple(said)
