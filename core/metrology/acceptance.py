"""Decision whether a robot keeps what its data sheet states, by the guard bands of ISO 14253-1.

Conformity is stated where the whole interval of the figure lies within the limit, nonconformity where the whole
interval lies beyond it; between them the result is inconclusive, and the interval is the guard band on both sides.

The figure is the worst of several poses. All of them must conform, so that no pose needs more than its own level to
pass. One pose that does not conform is enough to fail, so that each of m is judged at the m-th part of the risk;
the interval is widened for that on the logarithmic scale, on which the intervals of scatter are nearly symmetric.

References: ISO 14253-1:2017, 5.2-5.4; JCGM 106:2012, 8.3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from scipy.special import ndtri

from core.errors import listed
from core.metrology.accuracy import FrameTie, poses_that_decide
from core.metrology.repeatability import FEW_CYCLES, PoseRepeatability
from core.metrology.rp_distribution import CONFIDENCE

RULE = "ISO 14253-1 guard band"
MOST_CYCLES = 1000
"""More are not proposed: the robot is too near to its limit for a decision."""


UNMEASURED = "without a cycle that counts"
TOO_FEW = "of fewer than ten cycles"
UNSTEADY = "whose cycles are not steady"
UNTESTED = "whose steadiness was not tested, for want of cycle numbers"
REPEATED = "with several visits of one cycle that no burst names"
UNCHANGING = "whose readings do not change"
ROUNDED = "whose scatter the resolution of the readings hides"
WITHOUT_DEGRADED = "within the limit only without cycles whose images are degraded"
"""Why a reading decides nothing."""


class Decision(StrEnum):
    """What is decided of a limit."""

    PASS = "pass"  # noqa: S105 - not a password
    FAIL = "fail"
    INCONCLUSIVE = "inconclusive"


@dataclass(frozen=True, slots=True)
class Reading:
    """A figure of one pose that stands for the robot, in the limit's unit, from so many cycles.

    `value` and `interval` are the robot's own, without the instrument's share; None where that share is too large or
    not known. `at_most` is an upper limit that holds with the instrument's share in it. `flaw` says why the figure
    decides nothing: its interval presumes what is not so, or was not tested; None where nothing
    speaks against it; it follows the poses' names.

    `cycles_share` is the share of the interval's squared width that cycles narrow. `tie` is what tied the frames of a
    deviation, which poses narrow; None for a figure of scatter. `frames` follows the word interval, such as " in the
    frames of the other poses".
    """

    cycles: int
    value: float | None
    interval: tuple[float, float] | None
    at_most: float | None
    flaw: str | None = None
    cycles_share: float = 1.0
    tie: FrameTie | None = None
    frames: str = ""

    @property
    def deciding(self) -> tuple[float, float] | None:
        """The interval that decides: from nothing to the upper limit that is known; None without one."""
        if self.interval is not None:
            return self.interval
        return None if self.at_most is None else (0.0, self.at_most)

    @property
    def upper(self) -> float:
        """The limit that the figure does not exceed; infinite where none is known."""
        if self.interval is not None:
            return self.interval[1]
        return math.inf if self.at_most is None else self.at_most


@dataclass(frozen=True, slots=True)
class Acceptance:
    """The decision on one limit, the index of the reading that it rests on, why, and the cycles that would decide.

    `interval` is that of the reading, in which the decision is; None where none rests on a reading. `cycles_needed` and
    `poses_needed` are for this reading, if its value stays: None where a decision was made, where no number up to
    `MOST_CYCLES` cycles and `MOST_POSES` poses would, and of poses where cycles do.
    """

    decision: Decision
    reading: int | None
    reason: str
    interval: tuple[float, float] | None = None
    cycles_needed: int | None = None
    poses_needed: int | None = None


def decide(limit: float, readings: Sequence[Reading], names: Sequence[str] | None = None) -> Acceptance:
    """Decide on a limit that every reading must keep.

    Readings of fewer than ten cycles, or with a flaw, decide nothing, neither alone nor for the rest: what was not
    measured may be the worst. `names` are the readings' poses, for the reason; None numbers them from 1.
    """
    called = names if names is not None else [str(i + 1) for i in range(len(readings))]
    flaws = [_flaw(one) for one in readings]
    usable = [i for i, flaw in enumerate(flaws) if flaw is None]
    failed = [i for i in usable if _low(readings[i], len(usable)) > limit]
    if failed:
        worst = max(failed, key=lambda i: _low(readings[i], len(usable)))
        low, high = readings[worst].deciding or (0.0, math.inf)
        reason = "the whole interval lies beyond the limit"
        if len(usable) > 1:
            reason += f", as does the wider one by which each of {len(usable)} poses is judged"
        return Acceptance(Decision.FAIL, worst, reason, (low, high))
    if not usable:
        return Acceptance(Decision.INCONCLUSIVE, None, _undecided(flaws, called))
    worst = max(usable, key=lambda i: readings[i].upper)
    interval = readings[worst].deciding
    if readings[worst].upper > limit:
        return _open(limit, readings[worst], worst, len(usable))
    if len(usable) < len(readings):
        return Acceptance(Decision.INCONCLUSIVE, None, _undecided(flaws, called))
    return Acceptance(Decision.PASS, worst, "the intervals of all poses lie within the limit", interval)


def _flaw(reading: Reading) -> str | None:
    """Return why a reading decides nothing; None where it can."""
    if reading.cycles == 0:
        return UNMEASURED
    return TOO_FEW if reading.cycles < FEW_CYCLES else reading.flaw


def _undecided(flaws: Sequence[str | None], names: Sequence[str]) -> str:
    """Name the poses that decide nothing, by the reasons."""
    found: dict[str, list[str]] = {}
    for name, flaw in zip(names, flaws, strict=True):
        if flaw is not None:
            found.setdefault(flaw, []).append(name)
    kinds = "; ".join(f"{listed(of_kind)}, {flaw}" for flaw, of_kind in found.items())
    count = sum(map(len, found.values()))
    return f"{count} of {len(flaws)} poses {'is' if count == 1 else 'are'} open: {kinds}"


def repeatability_reading(figures: PoseRepeatability) -> Reading:
    """Return what RP_l of a pose decides with: the corrected figure, where its interval is known."""
    if figures.interval.position_mm is None:
        return Reading(figures.n, None, None, None, scatter_flaw(figures))
    corrected = figures.corrected_interval.position_mm
    return Reading(
        figures.n,
        None if corrected is None else figures.corrected.position_mm,
        corrected,
        figures.interval.position_mm[1],
        scatter_flaw(figures) or (UNSTEADY if figures.verdict == "not_steady" else None),
    )


def scatter_flaw(figures: PoseRepeatability) -> str | None:
    """Return why the readings of a pose say nothing of its scatter; None where they do."""
    if figures.repeatability.position_mm == 0.0:
        return UNCHANGING
    return ROUNDED if figures.resolution is not None and figures.resolution.hides_position else None


def _low(reading: Reading, count: int) -> float:
    """Return the lower limit at the level that makes the risk of `count` readings together that of one."""
    if reading.interval is None or not reading.value:
        return 0.0
    low = reading.interval[0]
    if not 0.0 < low < reading.value:
        return min(low, reading.value)
    tail = (1.0 - CONFIDENCE) / 2.0
    wider = float(ndtri(tail / count) / ndtri(tail))
    return float(reading.value * (low / reading.value) ** wider)


def _open(limit: float, reading: Reading, place: int, count: int) -> Acceptance:
    """Return why a reading is open, and the cycles or poses that would decide."""
    interval = reading.deciding
    if reading.interval is None or not reading.value:
        reason = "the instrument's share of the reading is too large, or not known"
        return Acceptance(Decision.INCONCLUSIVE, place, reason, interval)
    reason = f"the interval{reading.frames} spans the limit"
    if reading.interval[0] > limit:
        reason = f"the interval lies beyond the limit, but not the wider one by which each of {count} poses is judged"
    cycles = _cycles_that_decide(limit, reading, count)
    if cycles is not None or reading.tie is None:
        return Acceptance(Decision.INCONCLUSIVE, place, reason, interval, cycles)
    poses = poses_that_decide(limit, reading.tie)
    reason += "; how the poses tie the frames is open, which more poses narrow and more cycles do not"
    return Acceptance(Decision.INCONCLUSIVE, place, reason, interval, None, poses)


def _cycles_that_decide(limit: float, reading: Reading, count: int) -> int | None:
    """Return how many cycles would decide if the value stayed, None for none up to `MOST_CYCLES`.

    Of the squared width of the interval's logarithm, the share that cycles narrow goes with one over their number.
    """
    if reading.interval is None or not reading.value:
        return None
    distance = abs(math.log(limit / reading.value)) if limit > 0.0 else math.inf
    end = reading.interval[1] if reading.value < limit else _low(reading, count)
    width = abs(math.log(end / reading.value)) if end > 0.0 else math.inf
    left = distance**2 - (1.0 - reading.cycles_share) * width**2
    if distance == 0.0 or not math.isfinite(width) or not left > 0.0:
        return None
    needed = 1 + math.ceil((reading.cycles - 1) * reading.cycles_share * width**2 / left)
    return needed if reading.cycles < needed <= MOST_CYCLES else None
