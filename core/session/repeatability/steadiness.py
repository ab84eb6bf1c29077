"""Steadiness of a session: the visits of all poses in the order of their cycles, and what it means for each pose."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.errors import Advisory, listed
from core.metrology import (
    CORRELATED,
    MIN_CYCLES,
    NOT_STEADY,
    UNSTEADY,
    UNTESTED,
    Attribution,
    CycleProcess,
    DisplacedCycle,
    PerComponent,
    PoseRepeatability,
    PoseSeries,
    Steadiness,
    Verdict,
    are_unchanging,
    assess_steadiness,
    deviations,
    equal_scale,
    estimate_process,
    hides_scatter,
)
from core.session.model import MeasuredPose
from core.session.visits import positions_of, stack_all

MIN_STATED_CORRELATION = 0.1
"""Below it, a correlation of successive cycles does not visibly widen an interval."""
MIN_INTERVAL_CYCLES = 5
"""Poses of fewer cycles say nothing about the process that cycles follow."""


@dataclass(frozen=True, slots=True)
class SessionSteadiness:
    """Steadiness of the poses of a session; places in `found` count `pose_ids`.

    `process` is what the cycles follow, for the intervals of all figures. `longest` is the number of cycles of the pose
    that has most.
    """

    pose_ids: tuple[str, ...]
    found: Steadiness
    process: CycleProcess
    longest: int

    @property
    def moved(self) -> tuple[str, ...]:
        """The poses that are not steady."""
        return tuple(pose_id for i, pose_id in enumerate(self.pose_ids) if i in self.found.moved)

    def flaw(self, pose_id: str) -> str | None:
        """Return why no decision can rest on a pose's cycles: they are not steady, or were not tested; None else."""
        if pose_id in self.moved:
            return UNSTEADY
        tested = {self.pose_ids[one.pose] for one in self.found.poses}
        return None if pose_id in tested else UNTESTED

    @property
    def effective_cycles(self) -> float:
        """How many independent cycles determine the scatter of the pose with most cycles as well as its own do."""
        return self.process.effective_cycles(self.longest)


def session_steadiness(
    visits: Mapping[str, Sequence[MeasuredPose]], mistaken: Collection[str] = ()
) -> SessionSteadiness:
    """Test the visits of all poses, each in the order of its cycles.

    Poses without a visit, or whose readings do not change, are not tested. Poses whose scatter the resolution of the
    readings hides say nothing of the process, nor do visits of another pose (`mistaken`, by `measurement_id`).
    """
    every = {pose_id: _series(found) for pose_id, found in visits.items() if found}
    chosen = {pose_id: one for pose_id, one in every.items() if not are_unchanging(one.positions_mm)}
    series = list(chosen.values())
    found = assess_steadiness(series)
    is_correlated = found.p_values is not None and found.p_values.autocorrelation <= CORRELATED
    process = _process([visits[pose_id] for pose_id in chosen], mistaken, is_correlated=is_correlated)
    longest = max((len(one.positions_mm) for one in series), default=0)
    return SessionSteadiness(tuple(chosen), found, process, longest)


def process_without(
    steadiness: SessionSteadiness, visits: Mapping[str, Sequence[MeasuredPose]], excluded: Collection[str]
) -> CycleProcess:
    """Return the process of a session's cycles without those of these measurements."""
    p_values = steadiness.found.p_values
    is_correlated = p_values is not None and p_values.autocorrelation <= CORRELATED
    return _process([visits[name] for name in steadiness.pose_ids], excluded, is_correlated=is_correlated)


def _process(
    poses: Sequence[Sequence[MeasuredPose]], excluded: Collection[str], *, is_correlated: bool
) -> CycleProcess:
    kept = [[visit for visit in of_pose if visit.measurement_id not in excluded] for of_pose in poses]
    series = [_series(of_pose) for of_pose in kept if len(of_pose) >= MIN_INTERVAL_CYCLES]
    usable = [one for one in series if not hides_scatter(one.positions_mm)]
    return estimate_process(
        [_equal_deviations(one) for one in usable], [one.cycles for one in usable], is_correlated
    )


def equal_deviations(visits: Sequence[MeasuredPose]) -> Float[np.ndarray, "n 3"]:
    """Return deviations of positions from their mean, mm, scaled to equal variance where the noise differs."""
    return _equal_deviations(_series(visits))


def _equal_deviations(series: PoseSeries) -> Float[np.ndarray, "n 3"]:
    return equal_scale(deviations(series.positions_mm), series.noise)


def _series(visits: Sequence[MeasuredPose]) -> PoseSeries:
    cycles = [visit.cycle for visit in visits if visit.cycle is not None]
    return PoseSeries(
        positions_of(visits),
        np.array(cycles, dtype=np.intp) if len(cycles) == len(visits) else None,
        visits[0].frame,
        stack_all(None if visit.scatter is None else visit.scatter[:3, :3] for visit in visits),
    )


def not_steady(figures: PoseRepeatability) -> PoseRepeatability:
    """Return the figures of a pose whose cycles are not steady: no verdict says what they measure."""

    def judged(verdict: Verdict | None) -> Verdict | None:
        return verdict if verdict in (None, Verdict.TOO_FEW_CYCLES) else Verdict.NOT_STEADY

    return replace(
        figures,
        verdict=judged(figures.verdict) or figures.verdict,
        verdicts=PerComponent(*(judged(verdict) for _, verdict in figures.verdicts.items())),
    )


def without_robot_verdict(figures: PoseRepeatability) -> PoseRepeatability:
    """Return the figures of a pose that scatters by its camera's change, by what its images do not all show, or by a
    visit that is not its own.

    No verdict is `robot`, and nothing is subtracted from the figures: the instrument's share is not known.
    """

    def judged(verdict: Verdict | None) -> Verdict | None:
        return Verdict.INSTRUMENT_LIMITED if verdict == Verdict.ROBOT else verdict

    return replace(
        figures,
        verdict=judged(figures.verdict) or figures.verdict,
        verdicts=PerComponent(*(judged(verdict) for _, verdict in figures.verdicts.items())),
        corrected=figures.repeatability,
        corrected_interval=PerComponent(None, None, None, None, None, None, None),
    )


def too_few_cycles(figures: PoseRepeatability) -> PoseRepeatability:
    """Return the figures of a pose whose visits are too few different ones."""
    verdicts = (
        None if verdict is None else Verdict.TOO_FEW_CYCLES for _, verdict in figures.verdicts.items()
    )
    return replace(figures, verdict=Verdict.TOO_FEW_CYCLES, verdicts=PerComponent(*verdicts))


def steadiness_warnings(steadiness: SessionSteadiness, *, instrument: bool = False) -> list[Advisory]:
    """Say what moved, by how much and from which cycle on, in which cycles all poses were displaced, which poses have
    two stopping points, or why nothing was tested; of readings of another `instrument`, in its words.
    """
    found = steadiness.found
    warnings = []
    if found.p_values is None and steadiness.longest > 1:
        warnings.append(
            Advisory(
                "steadiness_not_tested",
                f"Whether the cycles are steady was not tested: no pose has {MIN_CYCLES} visits with a cycle number "
                "each.",
                f"{'Give every reading' if instrument else 'Tag every image with'} its cycle, and run 30 cycles.",
            )
        )
    if found.p_values is not None and found.p_values.overall <= NOT_STEADY:
        warnings.append(_motion_warning(steadiness, instrument=instrument))
    if found.displaced:
        warnings.append(_displaced_warning(found.displaced))
    if found.two_points:
        named = listed(steadiness.pose_ids[one.pose] for one in found.two_points)
        first = found.two_points[0]
        noun = "Pose" if len(found.two_points) == 1 else "Poses"
        warnings.append(
            Advisory(
                "two_stopping_points",
                f"{noun} {named}: the cycles form two clusters, {_length(first.distance_mm)} apart with "
                f"{int(first.second.sum())} of {len(first.second)} cycles in the smaller one (of the first).",
                "Look for play, for a pose reached from two directions or in two configurations, and for two poses "
                "under one tag.",
            )
        )
    return warnings


_CAUSES = {
    Attribution.COMMON: (
        "All poses move together: the camera's mount, the target, or the temperature of either, not one joint.",
        "Fix the camera and the target, let robot and camera warm up, and measure again. A second target that no "
        "robot moves, measured in each cycle, separates the camera from the robot.",
    ),
    Attribution.POSE_BY_POSE: (
        "The poses move each by itself: this is the robot.",
        "Let the robot warm up, look for slipping or stick-slip in the joints that these poses load, and measure "
        "again.",
    ),
    Attribution.UNDETERMINED: (
        "Whether the motion is common to all poses is not determined.",
        "Measure at least two poses in 30 cycles each, after the robot and the camera have warmed up.",
    ),
}
_OF_INSTRUMENT = {
    Attribution.COMMON: (
        "All poses move together: the instrument's station, the probe or reflector, the robot's base, or the "
        "temperature of one of them, not one joint.",
        "Fix the instrument and its reflector, let robot and instrument warm up, and measure again. A fixed reflector, "
        "read in each cycle, separates the instrument from the robot.",
    ),
    Attribution.UNDETERMINED: (
        _CAUSES[Attribution.UNDETERMINED][0],
        "Measure at least two poses in 30 cycles each, after the robot and the instrument have warmed up.",
    ),
}
"""In place of the causes that have a camera."""


def _motion_warning(steadiness: SessionSteadiness, *, instrument: bool) -> Advisory:
    found = steadiness.found
    assert found.p_values is not None
    causes = _CAUSES | _OF_INSTRUMENT if instrument else _CAUSES
    cause, advice = causes[found.attribution or Attribution.UNDETERMINED]
    moved = [one for one in found.poses if one.pose in found.moved]
    named = listed(steadiness.pose_ids[one.pose] for one in moved)
    parts = [
        f"The cycles are not independent and identically distributed (p = {found.p_values.overall:.2g}; poses "
        f"{named}). {cause}"
    ]
    unit = "visit" if found.grid is not None and found.grid.by_visit else "cycle"
    if found.attribution is Attribution.POSE_BY_POSE:
        furthest = max(moved, key=lambda one: float(np.linalg.norm(one.change_mm)))
        parts.append(
            f"Pose {steadiness.pose_ids[furthest.pose]} moved {_length(float(np.linalg.norm(furthest.change_mm)))} "
            f"over the session by its trend, its largest step at {unit} {furthest.change_cycle}."
        )
    elif found.trend is not None and found.change_point is not None:
        trend, step = (
            float(np.linalg.norm(one)) for one in (found.trend.change_mm, found.change_point.step_mm)
        )
        parts.append(
            f"The motion that the poses share is {_length(trend, step)} over the session by its trend, or a step of "
            f"{_length(step, trend)} at {unit} {found.change_point.cycle}."
        )
    if steadiness.process.lag_correlation >= MIN_STATED_CORRELATION:
        parts.append(
            f"Successive cycles correlate by {steadiness.process.lag_correlation:.2f}; the intervals hold for that."
        )
    else:
        parts.append("Repeatability and its interval describe this session, not a longer one.")
    return Advisory("not_steady", " ".join(parts), advice)


def _displaced_warning(displaced: Sequence[DisplacedCycle]) -> Advisory:
    named = listed(
        f"cycle {one.cycle} by {_length(float(np.linalg.norm(one.displacement_mm)))}" for one in displaced
    )
    return Advisory(
        "cycle_displaced",
        f"All poses were displaced together: {named}. In the other cycles their common motion is usually "
        f"{_length(displaced[0].usual_mm)}. Mount, target or instrument was bumped in that cycle. That is in the "
        "figures of all poses, which are therefore not said to be the robot's.",
        "Look at the images or readings of that cycle. Fix what moved, exclude them with that reason, and repeat the "
        "cycle.",
    )


def _length(value: float, other: float = 0.0) -> str:
    """Return a length in the unit of the larger one of two that are compared."""
    return f"{value:.3g} mm" if max(value, other) >= 0.1 else f"{1e3 * value:.2g} µm"
