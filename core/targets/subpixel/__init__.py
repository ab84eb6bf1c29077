"""Corners at full resolution: the corner model's refinement, the smooth map of the grid, and outliers."""

from core.targets.subpixel.corner_acceptance import RefinedCorners
from core.targets.subpixel.neighbour_outliers import is_well_distributed, neighbour_inliers
from core.targets.subpixel.refinement import refine_corners
from core.targets.subpixel.sampling import largest_level, levels_between, nearest_levels
from core.targets.subpixel.smooth_map import GridBasis, grid_basis, grid_shape

__all__ = [
    "GridBasis",
    "RefinedCorners",
    "grid_basis",
    "grid_shape",
    "is_well_distributed",
    "largest_level",
    "levels_between",
    "nearest_levels",
    "neighbour_inliers",
    "refine_corners",
]
