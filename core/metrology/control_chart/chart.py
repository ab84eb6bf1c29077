"""The control chart of one figure over comparable sessions: limits, an EWMA, alarms, and since when.

Figures that are lengths above zero (RP, AP, floors) are charted by their logarithms, whose scatter does not grow with
them and is near normal; others as they are. Individuals are the classical plot, with limits from the mean
moving range. What raises an alarm of a lasting change is the EWMA of self-starting scores, since its
false-alarm rate is the one stated, with parameters that nobody knew beforehand.

The change is placed where it is most likely, given the values up to the alarm.

References: ISO 7870-2:2013 (individuals); ISO 7870-6:2016 (EWMA); Samuel, Pignatiello and Calvin,
"Identifying the time of a step change with X-bar control charts", Quality Engineering 10(3), 1998, eq. (3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from core.errors import InvalidArgument
from core.metrology.control_chart.run_length import ewma_limit
from core.metrology.control_chart.self_starting import FIRST, self_starting_scores

MIN_POINTS = 5
"""Sessions below which a chart is not drawn: limits from fewer moving ranges say nothing."""
SMOOTHING = 0.2
"""λ: near the best for a shift of one to one and a half standard deviations."""
RUN_LENGTH = 370.0
"""Sessions between false alarms, in the mean: as with three-sigma limits of a single chart."""
_RANGE_TO_SIGMA = 2.0 / math.sqrt(math.pi)
"""d₂ of two values: mean absolute difference of two normal values, in standard deviations."""
_ROUNDING = 1e-12
"""Share of a value below which a difference is that of adding numbers."""

Direction = Literal["up", "down"]


@dataclass(frozen=True, slots=True)
class IndividualsLimits:
    """Centre and three-sigma limits of single values, in the figure's unit."""

    centre: float
    lower: float
    upper: float


@dataclass(frozen=True, slots=True)
class Alarm:
    """The EWMA left its limits: at which point, which way, and from which point on the figure is another.

    `before` and `after` are the mean levels of the points before and from `since` on (geometric for logarithms).
    """

    at: int
    since: int
    direction: Direction
    before: float
    after: float


@dataclass(frozen=True, slots=True)
class ControlChart:
    """A chart of n values in time order.

    `ewma` is NaN for the first two points. `outside` are points beyond the individuals' limits: single
    sessions that stand out, 0.27 % of them by chance where values are normal and the limits exact.
    """

    values: Float[np.ndarray, " n"]
    limits: IndividualsLimits
    outside: tuple[int, ...]
    ewma: Float[np.ndarray, " n"]
    ewma_limit: float
    alarm: Alarm | None


def chart_figure(
    values: Float[np.ndarray, " n"] | Sequence[float],
    *,
    logarithms: bool,
    run_length: float = RUN_LENGTH,
) -> ControlChart:
    """Return the control chart of a figure over sessions in time order, and the first lasting change.

    Parameters
    ----------
    values: (n,) one figure for each session, in its unit; n at least `MIN_POINTS`.
    logarithms: whether the figure is above zero by its nature, and charted by its logarithm.
    run_length: sessions between false alarms of the EWMA, in the mean.

    Raises InvalidArgument for too few values, and for those that are not finite or, with logarithms, not above zero.
    """
    given = np.asarray(values, float)
    if len(given) < MIN_POINTS:
        raise InvalidArgument(
            f"A control chart takes {MIN_POINTS} sessions, and there are {len(given)}.",
            "Measure more sessions of the same poses under the same conditions.",
        )
    if not np.isfinite(given).all() or (logarithms and (given <= 0.0).any()):
        raise InvalidArgument("A control chart takes finite values, and of lengths those above zero.")
    x = np.log(given) if logarithms else given
    centre = float(x.mean())
    reach = 3.0 * float(np.abs(np.diff(x)).mean()) / _RANGE_TO_SIGMA
    unit = math.exp if logarithms else float
    limits = IndividualsLimits(unit(centre), unit(centre - reach), unit(centre + reach))
    ewma = _ewma(self_starting_scores(x), SMOOTHING)
    limit = ewma_limit(SMOOTHING, run_length) * math.sqrt(SMOOTHING / (2.0 - SMOOTHING))
    return ControlChart(
        values=given,
        limits=limits,
        outside=tuple(
            int(k) for k in np.flatnonzero(np.abs(x - centre) > reach + _ROUNDING * np.abs(x).max())
        ),
        ewma=np.concatenate([np.full(FIRST, np.nan), ewma]),
        ewma_limit=limit,
        alarm=_first_alarm(x, ewma, limit, logarithms=logarithms),
    )


def _ewma(scores: Float[np.ndarray, " n"], smoothing: float) -> Float[np.ndarray, " n"]:
    level, levels = 0.0, np.empty(len(scores))
    for k, score in enumerate(scores):
        level += smoothing * (score - level)
        levels[k] = level
    return levels


def _first_alarm(
    x: Float[np.ndarray, " n"], ewma: Float[np.ndarray, " m"], limit: float, *, logarithms: bool
) -> Alarm | None:
    beyond = np.flatnonzero(np.abs(ewma) > limit)
    if len(beyond) == 0:
        return None
    at = int(beyond[0]) + FIRST
    since = _most_likely_change(x[: at + 1])
    levels = (float(x[:since].mean()), float(x[since:].mean()))
    before, after = (math.exp(level) for level in levels) if logarithms else levels
    return Alarm(at, since, "up" if ewma[beyond[0]] > 0.0 else "down", before, after)


def _most_likely_change(x: Float[np.ndarray, " n"]) -> int:
    """Return the point from which on a mean is most likely another, variances equal; one point before it at least."""
    n = len(x)
    first = np.arange(1, n)
    sums = np.cumsum(x - x.mean())[:-1]  # of the first points, their mean's deviation times their number
    return int(first[np.argmax(sums**2 / (first * (n - first)))])
