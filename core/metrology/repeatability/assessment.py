"""Repeatability of the poses of a session: figures with intervals, noise floor, verdicts and warnings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from core.errors import Advisory
from core.geometry import rotation_to_rpy
from core.metrology.cycle_process import CycleProcess, shift_of_rp, shift_of_three_sigma
from core.metrology.iso9283 import deviations as about_mean
from core.metrology.iso9283 import three_sigma
from core.metrology.pose_cycles import (
    COMPONENTS,
    UNKNOWN_ANGLE,
    PerComponent,
    PoseCycles,
    angles_about_mean,
    as_triple,
)
from core.metrology.repeatability.intervals import (
    MAX_FLOOR_SHARE,
    assess_radial,
    assess_three_sigma,
)
from core.metrology.repeatability.outliers import Outlier, find_outliers
from core.metrology.repeatability.readings import (
    reading_warnings,
    scatter_unknown,
    with_resolution,
)
from core.metrology.repeatability.statistics import CycleStatistics, cycle_statistics
from core.metrology.repeatability.verdict import Verdict, classify
from core.metrology.resolution import Resolution, find_resolution
from core.metrology.steadiness import equal_scale

Interval = tuple[float, float]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class OrientationScatter:
    """Scatter of orientation in two other forms, rad.

    `vector_xyz`: 3 S of the rotation vectors about the mean, along the frame's axes: free of any singularity.
    `roll_pitch_yaw`: 3 S of the angles of each cycle as such, the standard's own wording (7.2.2).
    """

    vector_xyz: tuple[float, float, float]
    roll_pitch_yaw: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PoseRepeatability:
    """Repeatability of one pose from n cycles; mm and rad, in the frame of the measurements.

    Values are None below two cycles, for angles where no rotations were measured, and those of the instrument's part
    (`noise_floor`, `corrected`, `corrected_interval`) where no covariances were stated. Intervals and the corrected
    figure are also None where nothing scatters, or the `resolution` of the readings hides it. `repeatability` is RP_l
    of the position and 3 S of the others (ISO 9283:1998, 7.2.2), angles by rotation vectors mapped to roll, pitch, yaw.
    `interval`, `noise_floor`, `corrected` and `verdicts` are those of `.intervals`; `verdict` is the position's.
    `corrected_interval` of the position is None where the floor exceeds half of RP_l, since no known interval keeps
    its level there. ISO 9283 has no rejection: all cycles count. `outliers` names the cycles that no scatter explains
    by their index, and `without_outliers` is `repeatability` of the others; None without outliers.
    """

    n: int
    mean_position_mm: Float[np.ndarray, "3"]
    mean_roll_pitch_yaw: Float[np.ndarray, "3"] | None
    repeatability: PerComponent[float | None]
    interval: PerComponent[Interval | None]
    noise_floor: PerComponent[float | None]
    corrected: PerComponent[float | None]
    corrected_interval: PerComponent[Interval | None]
    verdict: Verdict
    verdicts: PerComponent[Verdict | None]
    orientation: OrientationScatter | None
    outliers: tuple[Outlier, ...]
    without_outliers: PerComponent[float | None] | None
    warnings: tuple[Advisory, ...]
    resolution: Resolution | None = None


def assess_repeatability(
    poses: Sequence[PoseCycles], process: CycleProcess | None = None
) -> list[PoseRepeatability]:
    """Return the figures of each pose, in the order given.

    `process` is what the cycles follow, None for independent Gaussian ones: intervals depend on it. The same cycles and
    process give the same result whatever else is in the list; nothing is random.
    """
    choices = [_choose(cycles) for cycles in poses]
    several = [choice.sample for choice in choices if len(choice.cycles) > 1]
    rows = iter(_assess(several, process) if several else [])
    return [_conclude(choice, next(rows) if len(choice.cycles) > 1 else {}) for choice in choices]


@dataclass(frozen=True, slots=True)
class _Choice:
    """The cycles of a pose, and the outliers among them."""

    cycles: PoseCycles
    sample: CycleStatistics
    outliers: tuple[Outlier, ...]
    without_outliers: PerComponent[float | None] | None
    warnings: tuple[Advisory, ...]
    resolution: Resolution | None


def _choose(stated: PoseCycles) -> _Choice:
    resolution = find_resolution(stated.positions_mm)
    cycles = with_resolution(stated, resolution)
    sample = cycle_statistics(cycles)
    outliers, warnings = find_outliers(cycles.positions_mm, sample.vectors)
    if not outliers:
        return _Choice(cycles, sample, (), None, tuple(warnings), resolution)
    rest = cycles.take(np.setdiff1d(np.arange(len(cycles)), [outlier.index for outlier in outliers]))
    without = _raw(cycle_statistics(rest))
    return _Choice(cycles, sample, tuple(outliers), without, tuple(warnings), resolution)


_COLUMNS = ("raw", "low", "high", "floor", "corrected", "corrected_low", "corrected_high")


def _assess(samples: list[CycleStatistics], process: CycleProcess | None) -> list[dict[str, list[float]]]:
    """Return for each pose the seven figures of the readings and of all that surrounds them."""
    cycles = np.array([float(len(s.cycles)) for s in samples])
    reading = np.array([s.reading for s in samples])
    variance = np.stack([s.variance for s in samples])
    radial = assess_radial(
        reading,
        np.stack([s.covariance for s in samples]),
        np.stack([s.noise_covariance for s in samples]),
        np.array([s.trace_excess for s in samples]),
        np.array([s.still for s in samples]),
        cycles,
    )
    sigma = assess_three_sigma(
        variance, np.stack([s.noise for s in samples]), np.stack([s.noise_square for s in samples]), cycles
    )
    columns = {"raw": np.column_stack([reading, 3.0 * np.sqrt(variance)])}
    for name in _COLUMNS[1:]:
        columns[name] = np.column_stack([getattr(radial, name), getattr(sigma, name)])
    if process is not None:
        _shift_intervals(columns, process, samples, radial.excess)
    # A perfect instrument would not have measured more: an excess of the figure over the raw one, or of a bound over
    # the raw bound, comes from rounding or from the division by the bias, not from the robot.
    for name in ("", "_low", "_high"):
        columns["corrected" + name] = np.minimum(columns["corrected" + name], columns[name[1:] or "raw"])
    # Where tails are heavy the bounds of RP_l are not about the reading; they contain it all the same, as the raw do.
    for name, widen in (("corrected_low", np.minimum), ("corrected_high", np.maximum)):
        columns[name][:, 0] = widen(columns[name][:, 0], columns["corrected"][:, 0])
    for values in columns.values():
        np.minimum(values[:, 4:], 3.0 * UNKNOWN_ANGLE, out=values[:, 4:])
    rows = zip(*(columns[name].tolist() for name in _COLUMNS), strict=True)
    return [dict(zip(_COLUMNS, row, strict=True)) for row in rows]


def _shift_intervals(
    columns: dict[str, Float[np.ndarray, "k 7"]],
    process: CycleProcess,
    samples: list[CycleStatistics],
    excess: Float[np.ndarray, " k"],
) -> None:
    """Move the bounds to where cycles of this process have them.

    The bounds of RP_l are about the reading. As far as tails are probably heavy they are about what the covariance lets
    expect instead: an outlier weighs less in it than in the reading, from which intervals would lie too high.

    The raw figure is the robot's with its instrument, and so is the process. What is subtracted is the instrument's
    expected variance, which does not depend on the order or the tails of few cycles: the corrected 3 S has the raw
    bounds less that variance. The logarithm of the corrected RP_l scatters more than that of the raw one, and its
    bounds move by as much more.
    """
    cycles = np.array([len(s.cycles) for s in samples])
    deviations = [equal_scale(about_mean(s.cycles.positions_mm), _position_noise(s)) for s in samples]
    noise = 9.0 * np.column_stack([np.zeros(len(samples)), np.stack([s.noise for s in samples])])
    low, high = columns["low"], columns["high"]
    corrected_low, corrected_high = columns["corrected_low"], columns["corrected_high"]
    wider = _log_width(corrected_low[:, 0], corrected_high[:, 0]) / _log_width(low[:, 0], high[:, 0])
    centre = float(process.tails.sum()) * excess
    for n in np.unique(cycles):
        rows = np.flatnonzero(cycles == n)
        radial = shift_of_rp(process, [deviations[i] for i in rows])
        sigma = shift_of_three_sigma(process, int(n))
        off = centre[rows]
        low[rows] *= np.exp(np.column_stack([radial.low - off, np.tile(sigma.low, (len(rows), 6))]))
        high[rows] *= np.exp(np.column_stack([radial.high - off, np.tile(sigma.high, (len(rows), 6))]))
        corrected_low[rows, 0] *= np.exp(wider[rows] * radial.low - off)
        corrected_high[rows, 0] *= np.exp(wider[rows] * radial.high - off)
    # A pose that reads more than the tails of all poses explain: its interval still contains what it read.
    np.minimum(low, columns["raw"], out=low)
    np.maximum(high, columns["raw"], out=high)
    for corrected, raw in ((corrected_low, low), (corrected_high, high)):
        corrected[:, 1:] = np.sqrt(np.maximum(raw[:, 1:] ** 2 - noise[:, 1:], 0.0))


def _position_noise(sample: CycleStatistics) -> Float[np.ndarray, "n 3 3"] | None:
    covariances = sample.cycles.covariances
    return None if covariances is None else covariances[:, :3, :3]


def _log_width(low: Float[np.ndarray, " k"], high: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Return log(high / low); one where there is no scatter or no lower bound."""
    known = (low > 0.0) & (high > low)
    return np.asarray(np.where(known, np.log(np.where(known, high / np.where(known, low, 1.0), 1.0)), 1.0))


def _raw(sample: CycleStatistics) -> PerComponent[float | None]:
    angles = np.minimum(3.0 * np.sqrt(sample.variance[3:]), 3.0 * UNKNOWN_ANGLE)
    values = [sample.reading, *(3.0 * np.sqrt(sample.variance[:3])).tolist()]
    return _figures(values if sample.mean_rotation is None else [*values, *angles.tolist()])


def _conclude(choice: _Choice, table: dict[str, list[float]]) -> PoseRepeatability:
    sample, n = choice.sample, len(choice.cycles)
    known = 4 if sample.mean_rotation is None else 7

    def values(name: str) -> list[float]:
        return table.get(name, [])[:known]

    noise_known = sample.cycles.covariances is not None
    corrected_interval: list[Interval | None] = list(
        zip(values("corrected_low"), values("corrected_high"), strict=True)
    )
    if table and table["floor"][0] > MAX_FLOOR_SHARE * table["raw"][0]:
        corrected_interval[0] = None
    unknown = scatter_unknown(values("raw"), choice.resolution)
    verdicts: list[Verdict] = [
        classify(reading, floor if noise_known and not (hidden and reading) else None, n)
        for reading, floor, hidden in zip(values("raw"), values("floor"), unknown, strict=True)
    ]

    def where_known(found: Sequence[T | None]) -> PerComponent[T | None]:
        return _figures([None if hidden else one for one, hidden in zip(found, unknown, strict=True)])

    return PoseRepeatability(
        n,
        sample.mean_position,
        None if sample.mean_rotation is None else rotation_to_rpy(sample.mean_rotation),
        _figures(values("raw")),
        where_known(list(zip(values("low"), values("high"), strict=True))),
        _figures(values("floor") if noise_known else []),
        where_known(values("corrected")) if noise_known else _figures([]),
        where_known(corrected_interval) if noise_known else _figures([]),
        verdicts[0] if verdicts else Verdict.TOO_FEW_CYCLES,
        _figures(verdicts),
        _orientation(sample),
        choice.outliers,
        choice.without_outliers,
        choice.warnings + reading_warnings(sample, choice.resolution),
        choice.resolution,
    )


def _figures(known: Sequence[T | None]) -> PerComponent[T | None]:
    return PerComponent(*known, *[None] * (len(COMPONENTS) - len(known)))


def _orientation(sample: CycleStatistics) -> OrientationScatter | None:
    rotations, mean, vectors = sample.cycles.rotations, sample.mean_rotation, sample.vectors
    if rotations is None or mean is None or vectors is None or len(vectors) < 2:
        return None
    return OrientationScatter(
        as_triple(three_sigma(vectors)), as_triple(three_sigma(angles_about_mean(rotations, mean)))
    )
