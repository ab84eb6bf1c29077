"""Printed targets: what they are, and finding them in an image."""

from core.targets.detect import DETECTABLE_KINDS, check_detectable, detect
from core.targets.specification import GridPoints, TargetSpec

__all__ = ["DETECTABLE_KINDS", "GridPoints", "TargetSpec", "check_detectable", "detect"]
