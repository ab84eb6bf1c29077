"""The control chart of one figure over comparable sessions: limits, an EWMA, alarms, and since when.

Figures that are lengths above zero (RP, AP, floors) are charted by their logarithms, whose scatter does not grow with
them and is near normal; others as they are. Individuals are the classical plot, with limits from the mean
moving range. What raises an alarm of a lasting change is the EWMA of self-starting scores, since its
false-alarm rate is the one stated, with parameters that nobody knew beforehand. A step early in the series becomes
part of the scatter that the scores are in, so that the EWMA may never show it, the less the larger it is: a small share
of the false alarms is spent on a test for two levels, which finds it.

The change is placed where it is most likely, given the values up to the alarm and the way it went.

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
from core.metrology.control_chart.change_point import Step, first_step
from core.metrology.control_chart.run_length import ewma_limit
from core.metrology.control_chart.self_starting import FIRST, self_starting_scores

MIN_POINTS = 5
"""Sessions below which a chart is not drawn: limits from fewer moving ranges say nothing."""
SMOOTHING = 0.2
"""λ: near the best for a shift of one to one and a half standard deviations."""
RUN_LENGTH = 370.0
"""Sessions between false alarms, in the mean: as with three-sigma limits of a single chart."""
_STEP_SHARE = 0.1
"""Of the false alarms, that of the test for two levels: it costs the EWMA little, and steps of five standard deviations
between sessions need no more."""
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
    """The EWMA left its limits, or two levels showed: at which point, which way, and from which point on the figure is
    another.

    `before` and `after` are the mean levels of the points before `since`, and from it to `at` (geometric for
    logarithms).
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
    run_length: sessions between false alarms, in the mean.

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
    limit = ewma_limit(SMOOTHING, run_length / (1.0 - _STEP_SHARE)) * math.sqrt(SMOOTHING / (2.0 - SMOOTHING))
    return ControlChart(
        values=given,
        limits=limits,
        outside=tuple(
            int(k) for k in np.flatnonzero(np.abs(x - centre) > reach + _ROUNDING * np.abs(x).max())
        ),
        ewma=np.concatenate([np.full(FIRST, np.nan), ewma]),
        ewma_limit=limit,
        alarm=_first_alarm(x, ewma, limit, _STEP_SHARE / run_length, logarithms=logarithms),
    )


def _ewma(scores: Float[np.ndarray, " n"], smoothing: float) -> Float[np.ndarray, " n"]:
    level, levels = 0.0, np.empty(len(scores))
    for k, score in enumerate(scores):
        level += smoothing * (score - level)
        levels[k] = level
    return levels


def _first_alarm(
    x: Float[np.ndarray, " n"],
    ewma: Float[np.ndarray, " m"],
    limit: float,
    step_risk: float,
    *,
    logarithms: bool,
) -> Alarm | None:
    beyond = np.flatnonzero(np.abs(ewma) > limit)[:1]
    found = next((Step(int(k) + FIRST, is_up=bool(ewma[k] > 0.0)) for k in beyond), None)
    # A step that shows together with the EWMA is the EWMA's, so that the points before are enough.
    found = first_step(x if found is None else x[: found.at], step_risk) or found
    if found is None:
        return None
    since = _most_likely_change(x[: found.at + 1], is_up=found.is_up)
    # Later points may be of a third level, even beyond the first.
    levels = (float(x[:since].mean()), float(x[since : found.at + 1].mean()))
    before, after = (math.exp(level) for level in levels) if logarithms else levels
    return Alarm(found.at, since, "up" if found.is_up else "down", before, after)


def _most_likely_change(x: Float[np.ndarray, " n"], *, is_up: bool) -> int:
    """Return the point from which on a mean is most likely another, this way; variances equal, one point before it at
    least.
    """
    n = len(x)
    first = np.arange(1, n)
    sums = np.cumsum(x - x.mean())[:-1]  # of the first points, their mean's deviation times their number
    risen = np.maximum(-sums if is_up else sums, 0.0)
    return int(first[np.argmax(risen**2 / (first * (n - first)))])
