"""Dot grids: blobs to ellipses to a lattice, their centres corrected for perspective and saturation."""

from core.targets.circles.blobs import find_dots
from core.targets.circles.detector import detect_circles
from core.targets.circles.ellipse_fit import ODD

__all__ = ["ODD", "detect_circles", "find_dots"]
