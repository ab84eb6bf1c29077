"""Sharpness, motion blur, exposure and coverage of one image, with advice."""

from core.targets.image_quality.assessment import assess_capture, with_tilt

__all__ = ["assess_capture", "with_tilt"]
