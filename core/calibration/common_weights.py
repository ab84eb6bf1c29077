"""One weight for a grid point in all images of a pose, so that what is systematic in its residual moves none of them.

The refiner estimates each corner's uncertainty anew from each picture, and these estimates scatter by some per cent.
Where residuals are noise alone that costs nothing. Where a print is bowed or a principal point is wrong, a residual far
larger than the noise is weighed a little otherwise in each image, and the pose moves with it: at 3 % scatter and
residuals of seven times the noise a motionless robot read up to 1.8 times its floor. So the pattern of uncertainties
over the points is taken from all images of a pose together; how sharp an image is as a whole stays its own, which no
pose depends on. A point that is far less certain in one image than in the others keeps that.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from core.calibration.view_stack import ViewStack, groups_of
from core.compiled import compiled

OWN = 1.5
"""A point's uncertainty in an image stays as it is where it exceeds the pattern by this factor."""


def with_common_weights(views: ViewStack, labels: Int[np.ndarray, " m"]) -> ViewStack:
    """Return the views with uncertainties of one pattern for all views of a label and target."""
    uncertainty = views.standard_uncertainty_px.copy()
    cells = [t.size for t in views.targets]
    changed = False
    for pose in groups_of(labels * len(views.targets) + views.target):
        if len(pose) > 1:
            size = cells[int(views.target[pose[0]])]
            weigh_alike(pose, views.first, views.cell, size, views.standard_uncertainty_px, OWN, uncertainty)
            changed = True
    return replace(views, standard_uncertainty_px=uncertainty) if changed else views


@compiled
def weigh_alike(
    pose: Int[np.ndarray, " k"],
    first: Int[np.ndarray, " bounds"],
    cell: Int[np.ndarray, " n"],
    cells: int,
    stated: Float[np.ndarray, " n"],
    own: float,
    result: Float[np.ndarray, " n"],
) -> None:
    """Write the uncertainties of one pose's views, level times pattern, where they are not left as stated.

    The pattern is the mean over the views of each cell's logarithm less the view's mean. What is no positive number or
    no cell of the target stays as it is: that is the checks' to name.
    """
    total, seen = np.zeros(cells), np.zeros(cells)
    levels = np.zeros(len(pose))
    for j in range(len(pose)):
        begin, end = first[pose[j]], first[pose[j] + 1]
        logs = np.zeros(end - begin)
        count = 0
        for k in range(begin, end):
            if 0.0 < stated[k] < np.inf and 0 <= cell[k] < cells:
                logs[k - begin] = np.log(stated[k])
                levels[j] += logs[k - begin]
                count += 1
        levels[j] /= max(count, 1)
        for k in range(begin, end):
            if 0.0 < stated[k] < np.inf and 0 <= cell[k] < cells:
                total[cell[k]] += logs[k - begin] - levels[j]
                seen[cell[k]] += 1.0
    pattern = np.exp(total / np.maximum(seen, 1.0))
    for j in range(len(pose)):
        level = np.exp(levels[j])
        for k in range(first[pose[j]], first[pose[j] + 1]):
            if 0.0 < stated[k] < np.inf and 0 <= cell[k] < cells:
                common = level * pattern[cell[k]]
                if stated[k] <= own * common:
                    result[k] = common
