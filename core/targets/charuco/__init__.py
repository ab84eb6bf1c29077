"""ChArUco boards: layout, markers on the lattice, and placement of lattices on the board."""

from core.targets.charuco.detector import detect_charuco, find_by_lattice
from core.targets.charuco.isolated_markers import Markers
from core.targets.charuco.layout import CharucoLayout, charuco_layout, marker_dictionary
from core.targets.charuco.placement import lattices_of

__all__ = [
    "CharucoLayout",
    "Markers",
    "charuco_layout",
    "detect_charuco",
    "find_by_lattice",
    "lattices_of",
    "marker_dictionary",
]
