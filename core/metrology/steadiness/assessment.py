"""Whether the cycles of a session are independent and identically distributed, and what moved where they are not.

Repeatability describes the scatter of cycles that do not depend on one another. A drift, a slip, a slow wander or two
stopping points make the figure depend on when and how long was measured, and its interval too narrow. The session is
not steady where the permutation test of nine statistics (`permutation_test`) has p ≤ .01, a pose has two stopping
points (`two_points`), or all poses were displaced together in a cycle (`displaced_cycles`).

What moved is attributed by the share of the poses' slow motion that is common to them (`motion.common_share`): about
1 / p for p poses that move each by itself, 1 for a motion of the camera's mount, the target, or by temperature, in the
frame of the measurements. Below twenty cycles, or for a single pose, it is not attributed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float

from core.metrology.steadiness.cycle_grid import CycleGrid, PoseSeries, cycle_grid
from core.metrology.steadiness.displaced_cycles import DisplacedCycle, find_displaced_cycles
from core.metrology.steadiness.motion import (
    ChangePoint,
    Trend,
    change_place,
    common_share,
    common_step,
    common_trend,
    pose_steps,
    pose_trends,
)
from core.metrology.steadiness.permutation_test import permutation_test
from core.metrology.steadiness.two_points import TwoPoints, find_two_points

NOT_STEADY = 0.01
"""Largest p at which the cycles are not independent and identically distributed."""
MIN_CYCLES = 6
"""Fewer cycles have too few orders for a p of .01: statistics are the same in reverse order, and 5! / 2 is 60."""
MIN_ATTRIBUTED = 20


class Attribution(StrEnum):
    """What a motion belongs to: all poses together, poses by themselves, or not known."""

    COMMON = "common"
    POSE_BY_POSE = "pose_by_pose"
    UNDETERMINED = "undetermined"


@dataclass(frozen=True, slots=True)
class SteadinessPValues:
    """p of the omnibus and of each kind of statistic (its own three together), and the permutations they rank among."""

    overall: float
    trend: float
    change_point: float
    autocorrelation: float
    permutations: int


@dataclass(frozen=True, slots=True)
class PoseMotion:
    """One tested pose, by its place in the list.

    `p_value` is adjusted for all poses (single step); `change_mm` is its trend over the session, `step_mm` its step at
    the session's change point, `change_cycle` the cycle at which its own step is largest.
    """

    pose: int
    p_value: float
    change_mm: Float[np.ndarray, "3"]
    step_mm: Float[np.ndarray, "3"] | None
    change_cycle: int | None


@dataclass(frozen=True, slots=True)
class Steadiness:
    """Result for a session; mm, in the frame of the measurements.

    `p_values`, `trend`, `change_point`, `common_share` and `poses` are None or empty where the order of the cycles was
    not tested; `grid` has the series that was. `moved` are the places of the poses that are not steady. Numbers of
    cycles count visits where `by_visit`. `displaced` are cycles in which all poses of the common motion were displaced.
    """

    cycles: int
    p_values: SteadinessPValues | None
    trend: Trend | None
    change_point: ChangePoint | None
    attribution: Attribution | None
    common_share: float | None
    poses: tuple[PoseMotion, ...]
    two_points: tuple[TwoPoints, ...]
    moved: frozenset[int]
    grid: CycleGrid | None
    displaced: tuple[DisplacedCycle, ...] = ()

    @property
    def steady(self) -> bool | None:
        """Whether nothing speaks against it; None where nothing was tested and nothing found."""
        if self.moved:
            return False
        return None if self.p_values is None else True


def assess_steadiness(series: Sequence[PoseSeries]) -> Steadiness:
    """Test the cycles of a session's poses, in the order given; nothing is random.

    Poses whose visits have no known order, or that have a single visit, are not in the test of order; nor is any pose
    where none has `MIN_CYCLES` cycles.
    """
    split = [
        found
        for i, one in enumerate(series)
        if (found := find_two_points(one.positions_mm, i, len(series))) is not None
    ]
    places = [i for i, one in enumerate(series) if one.cycles is not None and len(np.unique(one.cycles)) > 1]
    grid = cycle_grid([series[i] for i in places])
    bimodal = frozenset(one.pose for one in split)
    if grid is None or int(grid.present.sum(axis=0).max()) < MIN_CYCLES:
        cycles = 0 if grid is None else len(grid.numbers)
        return Steadiness(cycles, None, None, None, None, None, (), tuple(split), bimodal, None)
    test = permutation_test(grid)
    p_values = SteadinessPValues(test.overall, **test.kinds, permutations=test.permutations)
    attribution = share = None
    moved: frozenset[int] = frozenset()
    if test.overall <= NOT_STEADY:
        attribution, share = _attributed(grid)
        moved = frozenset(places[i] for i in _moving(grid, attribution, test.poses))
    displaced = find_displaced_cycles(grid)
    if displaced:
        moved |= frozenset(places[i] for i in np.flatnonzero((grid.weights != 0.0).any(axis=(1, 2))))
    place = change_place(grid, None)
    return Steadiness(
        len(grid.numbers),
        p_values,
        common_trend(grid),
        None if place is None else common_step(grid, place),
        attribution,
        share,
        _pose_motions(grid, places, test.poses, place),
        tuple(split),
        moved | bimodal,
        grid,
        displaced,
    )


def _attributed(grid: CycleGrid) -> tuple[Attribution, float | None]:
    poses = grid.present.shape[1]
    if poses < 2 or len(grid.numbers) < MIN_ATTRIBUTED:
        return Attribution.UNDETERMINED, None
    share = common_share(grid)
    if share is None:
        return Attribution.UNDETERMINED, None
    # Half-way between poses that move each by itself and poses that move as one.
    common = share > 0.5 * (1.0 + 1.0 / poses)
    return (Attribution.COMMON if common else Attribution.POSE_BY_POSE), share


def _moving(grid: CycleGrid, attribution: Attribution, p_values: Float[np.ndarray, " p"]) -> list[int]:
    """Return the poses that are not steady: those significant by themselves if the others are steady without them."""
    everyone = list(range(len(p_values)))
    named = [i for i in everyone if p_values[i] <= NOT_STEADY]
    if attribution is not Attribution.POSE_BY_POSE or not named:
        return everyone
    rest = np.setdiff1d(everyone, named)
    if len(rest) == 0:
        return named
    others = grid.take(rest)
    steady = (
        int(others.present.sum(axis=0).max()) >= MIN_CYCLES and permutation_test(others).overall > NOT_STEADY
    )
    return named if steady else everyone


def _pose_motions(
    grid: CycleGrid, places: Sequence[int], p_values: Float[np.ndarray, " p"], place: int | None
) -> tuple[PoseMotion, ...]:
    changes = pose_trends(grid)
    steps = None if place is None else pose_steps(grid, place)
    motions = []
    for i, pose in enumerate(places):
        own = change_place(grid, i)
        motions.append(
            PoseMotion(
                pose,
                float(p_values[i]),
                changes[i],
                None if steps is None else steps[i],
                None if own is None else int(grid.numbers[own]),
            )
        )
    return tuple(motions)
