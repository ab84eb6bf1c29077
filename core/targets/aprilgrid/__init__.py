"""AprilGrids: layout, tags on the lattice, and assembly of their pieces."""

from core.targets.aprilgrid.detector import detect_aprilgrid
from core.targets.aprilgrid.layout import BORDER_CELLS, TAG_CELLS, aprilgrid_layout

__all__ = ["BORDER_CELLS", "TAG_CELLS", "aprilgrid_layout", "detect_aprilgrid"]
