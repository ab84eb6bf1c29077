"""The difference of a figure between two sessions, from the figure and the interval of each.

Where two estimates are independent, the interval of their difference follows from their own intervals without their
distributions, and keeps what is asymmetric about these:

    lower = b - a - sqrt((b - b_lower)² + (a_upper - a)²),     upper = b - a + sqrt((b_upper - b)² + (a - a_lower)²)

For lengths above zero the same is done with logarithms: the ratio's interval, which never crosses zero.

References: Zou and Donner, "Construction of confidence intervals about effect measures: a general approach",
Statistics in Medicine 27, 2008, eq. (6) (the method of variance estimates recovery, MOVER).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from core.errors import InvalidArgument
from core.numerics import NORMAL_95

Change = Literal["larger", "smaller", "no_change_shown"]


@dataclass(frozen=True, slots=True)
class Difference:
    """Second less first, in the figure's unit, and the ratio second to first, both with intervals of the same level.

    The ratio is None where either figure or interval is not above zero. `change` says whether the ratio's
    interval, or without one the difference's, lies on one side of no change, and `deviation` how far from no change it
    is, in standard deviations of a normal distribution with that interval's half toward no change.
    """

    difference: float
    interval: tuple[float, float]
    ratio: float | None
    ratio_interval: tuple[float, float] | None
    change: Change
    deviation: float


def estimate_difference(
    first: float,
    first_interval: tuple[float, float],
    second: float,
    second_interval: tuple[float, float],
) -> Difference:
    """Return by how much a figure of the second session differs from that of the first.

    Figures and intervals are in one unit, the intervals of one level, and the estimates independent of one another.
    Raises InvalidArgument where an interval does not contain its figure.
    """
    for figure, (low, high) in ((first, first_interval), (second, second_interval)):
        if not (math.isfinite(low) and math.isfinite(high) and low <= figure <= high):
            raise InvalidArgument("A comparison takes figures within their intervals, all of them finite.")
    difference, interval = _recover(first, first_interval, second, second_interval)
    distance, (low, high) = difference, interval
    ratio = ratio_interval = None
    if first_interval[0] > 0.0 and second_interval[0] > 0.0:
        distance, (low, high) = _recover(
            math.log(first), _logs(first_interval), math.log(second), _logs(second_interval)
        )
        ratio, ratio_interval = math.exp(distance), (math.exp(low), math.exp(high))
    change: Change = "larger" if low > 0.0 else "smaller" if high < 0.0 else "no_change_shown"
    reach = distance - low if distance > 0.0 else high - distance
    deviation = NORMAL_95 * abs(distance) / reach if reach > 0.0 else 0.0 if distance == 0.0 else math.inf
    return Difference(difference, interval, ratio, ratio_interval, change, deviation)


def _recover(
    a: float, a_interval: tuple[float, float], b: float, b_interval: tuple[float, float]
) -> tuple[float, tuple[float, float]]:
    difference = b - a
    below = math.hypot(b - b_interval[0], a_interval[1] - a)
    above = math.hypot(b_interval[1] - b, a - a_interval[0])
    return difference, (difference - below, difference + above)


def _logs(interval: tuple[float, float]) -> tuple[float, float]:
    return math.log(interval[0]), math.log(interval[1])
