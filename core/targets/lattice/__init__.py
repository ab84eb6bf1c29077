"""Saddle points to a lattice of corners, for chessboards, ChArUco boards and AprilGrids."""

from core.targets.lattice.board_boundary import MIN_VISIBLE_SHARE, Board, bounded
from core.targets.lattice.corner_graph import EDGE_SIDE_OFFSET, MIN_COSINE, Patches, link
from core.targets.lattice.growing import MAX_REACH, grow_lattice
from core.targets.lattice.lattice import Lattice
from core.targets.lattice.pyramid import Level, blurred_levels, fine_levels, levels
from core.targets.lattice.saddle_points import Saddles, find_saddles

__all__ = [
    "EDGE_SIDE_OFFSET",
    "MAX_REACH",
    "MIN_COSINE",
    "MIN_VISIBLE_SHARE",
    "Board",
    "Lattice",
    "Level",
    "Patches",
    "Saddles",
    "blurred_levels",
    "bounded",
    "find_saddles",
    "fine_levels",
    "grow_lattice",
    "levels",
    "link",
]
