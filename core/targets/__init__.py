"""Printed targets: what they are, and finding them in an image."""

from core.targets.detect import check_detectable, detect
from core.targets.specification import GridPoints, TargetSpec
from core.targets.target_fields import check_fields

__all__ = ["GridPoints", "TargetSpec", "check_detectable", "check_fields", "detect"]
