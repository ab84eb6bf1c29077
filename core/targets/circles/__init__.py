"""Dot grids: blobs to ellipses to a lattice, their centres corrected for perspective and saturation."""

from core.targets.circles.blobs import find_dots
from core.targets.circles.centres import ODD
from core.targets.circles.detector import detect_circles

__all__ = ["ODD", "detect_circles", "find_dots"]
