"""How far the corners of a chessboard that are found are from the truth."""

from __future__ import annotations

import numpy as np

from core.simulation import Scene
from core.targets import GridPoints

LARGEST_ERROR_PX = 0.3


def errors(found: GridPoints, scene: Scene, shift: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    truth = scene.points_px.reshape(scene.target.rows, scene.target.columns, 2)
    return np.asarray(found.points_px + np.array(shift) - truth[found.row, found.column])


def worst(found: GridPoints, scene: Scene) -> float:
    """The largest error of a found corner, px, in the better of the two orders if colour leaves both."""
    target = scene.target
    truth = scene.points_px.reshape(target.rows, target.columns, 2)
    orders = [truth] if (target.columns + target.rows) % 2 else [truth, truth[::-1, ::-1]]
    return min(float(np.abs(found.points_px - order[found.row, found.column]).max()) for order in orders)
