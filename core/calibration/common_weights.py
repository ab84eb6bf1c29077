"""One weight for a grid point in all images of a pose, so that what is systematic in its residual moves none of them.

The refiner estimates each corner's uncertainty anew from each picture, and these estimates scatter by some per cent.
Where residuals are noise alone that costs nothing. Where a print is bowed or a principal point is wrong, a residual far
larger than the noise is weighed a little otherwise in each image, and the pose moves with it: at 3 % scatter and
residuals of seven times the noise a motionless robot read up to 1.8 times its floor. So the pattern of uncertainties
over the points is taken from all images of a pose together; how sharp an image is as a whole stays its own, which no
pose depends on. A point that is far less certain in one image than in the others keeps that.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np

from core.calibration.view_stack import ViewStack

OWN = 1.5
"""A point's uncertainty in an image stays as it is where it exceeds the pattern by this factor."""


def with_common_weights(views: ViewStack, labels: Sequence[Hashable]) -> ViewStack:
    """Return the views with uncertainties of one pattern for all views of a label and target."""
    place: dict[tuple[Hashable, int], int] = {}
    pose = np.array(
        [place.setdefault(key, len(place)) for key in zip(labels, views.target.tolist(), strict=True)],
        dtype=np.intp,
    )
    u = views.standard_uncertainty_px
    sound = np.isfinite(u) & (u > 0.0)  # what is not is the checks' to name
    if len(place) == len(views) or not sound.any():
        return views
    logs = np.log(np.where(sound, u, 1.0))
    counts = np.maximum(views.sums(sound.astype(np.float64)), 1.0)
    level = views.spread(views.sums(logs * sound) / counts)
    key = views.spread(pose) * max(t.size for t in views.targets) + views.cell
    seen = np.bincount(key, sound)
    pattern = np.bincount(key, (logs - level) * sound) / np.maximum(seen, 1.0)
    common = np.exp(level + pattern[key])
    chosen = sound & (u <= OWN * common)
    return replace(views, standard_uncertainty_px=np.where(chosen, common, u))
