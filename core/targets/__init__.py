"""Printed targets: what they are, and finding them in an image."""

from core.targets.specification import GridPoints, TargetSpec

__all__ = ["GridPoints", "TargetSpec"]
