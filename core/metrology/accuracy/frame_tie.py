"""How many poses narrow an interval of AP_p that the tie of the frames keeps wide.

The frames are tied by the poses themselves, and a deviation is known to t times s √k, s² the variance of all deviations
along an axis and k what the tie leaves open of one pose (`.accuracy`). Cycles narrow none of it. With m poses of the
same kind the tie's p parameters leave dof = 3 m - p degrees of freedom, the largest leverage h goes with 1 / m, and in
the frames of the others a deviation that is estimated as a has the length

    |a / √(1 - h) + t_dof-3 s √k|,     k = h / (1 - h).

All poses have to keep the limit, and the worst of more poses is worse: a is the median of the largest of m deviations,
or the largest that was found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

from core.metrology.rp_distribution import CONFIDENCE

MOST_POSES = 100
"""More are not proposed."""
_DRAWS = 4000
_SEED = 9283


@dataclass(frozen=True, slots=True)
class FrameTie:
    """What tied the frames of deviations: s², mm², m poses, their degrees of freedom, the largest leverage of a pose,
    and the largest AP_p, mm.
    """

    variance: float
    poses: int
    degrees_of_freedom: float
    leverage: float
    worst_mm: float


def poses_that_decide(limit: float, tie: FrameTie) -> int | None:
    """Return how many poses would probably decide on a limit, in place of those that tie the frames now.

    None where no number up to `MOST_POSES` would, or the worst pose is at the limit. A pose beyond the limit is decided
    by its lower bound, at the level that all poses together need.
    """
    parameters = 3.0 * tie.poses - tie.degrees_of_freedom
    if tie.worst_mm == limit or parameters <= 0.0 or tie.variance <= 0.0:
        return None
    rng = np.random.default_rng(_SEED)
    normal, chi = rng.standard_normal((_DRAWS, 3)), rng.standard_normal((_DRAWS, 3 * MOST_POSES))
    squares = np.cumsum(chi**2, axis=1)
    tail = (1.0 - CONFIDENCE) / 2.0
    for poses in range(tie.poses + 1, MOST_POSES + 1):
        freedom = math.floor(3.0 * poses - parameters - 3.0)
        h = tie.leverage * tie.poses / poses
        if freedom < 1 or h >= 1.0:
            continue
        spread = np.sqrt(tie.variance * h / (1.0 - h) * freedom / squares[:, freedom - 1])
        if tie.worst_mm > limit:
            if np.quantile(_lengths(tie.worst_mm, normal, spread), tail / poses) > limit:
                return poses
            continue
        largest = math.sqrt(tie.variance * float(chdtri(3.0, 1.0 - 0.5 ** (1.0 / poses))))
        value = max(tie.worst_mm, largest) / math.sqrt(1.0 - h)
        if np.quantile(_lengths(value, normal, spread), 1.0 - tail) <= limit:
            return poses
    return None


def _lengths(
    value: float, normal: Float[np.ndarray, "t 3"], spread: Float[np.ndarray, " t"]
) -> Float[np.ndarray, " t"]:
    off = normal * spread[:, None]
    off[:, 0] += value
    return np.asarray(np.linalg.norm(off, axis=1))
