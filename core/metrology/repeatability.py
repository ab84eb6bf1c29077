"""Repeatability of whole sessions: every pose's figures, with all that is needed to trust them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from core.errors import Advisory
from core.metrology.exclusions import Exclusion, find_outliers
from core.metrology.figures import FIGURE_NAMES, Figures
from core.metrology.iso9283 import three_sigma
from core.metrology.orientation import (
    UNKNOWN_ANGLE,
    angles_about_mean,
)
from core.metrology.poses import PoseCycles
from core.metrology.sample import Sample, sample_of
from core.metrology.uncertainty import (
    SOUND_FLOOR,
    Limits,
    Verdict,
    assess_radial,
    assess_three_sigma,
    judge,
)
from core.transforms import GIMBAL_MARGIN, rotation_to_rpy

Interval = tuple[float, float]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class OrientationScatter:
    """Scatter of orientation told otherwise, rad.

    `vector_xyz`: 3 S of the rotation vectors about the mean, along the frame's axes: free of any singularity.
    `roll_pitch_yaw`: 3 S of the angles of each cycle as such, the standard's own wording (7.2.2).
    """

    vector_xyz: tuple[float, float, float]
    roll_pitch_yaw: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PoseRepeatability:
    """What n cycles say of one pose; mm and rad, in the frame of the measurements.

    Values are None below two cycles, and for angles where no rotations were measured. `repeatability` is RP_l of the
    position and 3 S of the others (ISO 9283:1998, 7.2.2), angles by rotation vectors mapped to roll, pitch, yaw.
    `interval`, `noise_floor`, `corrected` and `verdicts` are those of `core.metrology.uncertainty`; `verdict` is the
    position's. `corrected_interval` of the position is None where the floor exceeds half of the reading, since no
    interval found keeps its level there. `excluded` names the cycles left out by their index, and `with_excluded` is
    `repeatability` with them.
    """

    n: int
    mean_position_mm: Float[np.ndarray, "3"]
    mean_rotation: Float[np.ndarray, "3 3"] | None
    mean_roll_pitch_yaw: Float[np.ndarray, "3"] | None
    repeatability: Figures[float | None]
    interval: Figures[Interval | None]
    noise_floor: Figures[float | None]
    corrected: Figures[float | None]
    corrected_interval: Figures[Interval | None]
    verdict: Verdict
    verdicts: Figures[Verdict | None]
    orientation: OrientationScatter | None
    used: tuple[int, ...]
    excluded: tuple[Exclusion, ...]
    with_excluded: Figures[float | None] | None
    warnings: tuple[Advisory, ...]


def assess_repeatability(
    poses: Sequence[PoseCycles], limits: Limits | None = None, *, exclude_outliers: bool = True
) -> list[PoseRepeatability]:
    """Return the figures of each pose, in the order given.

    The same cycles give the same result whatever else is in the list; nothing is random.
    """
    limits = limits or Limits()
    choices = [_choose(cycles, exclude_outliers) for cycles in poses]
    several = [choice.sample for choice in choices if len(choice.cycles) > 1]
    rows = iter(_assess(several) if several else [])
    return [_conclude(choice, next(rows) if len(choice.cycles) > 1 else {}, limits) for choice in choices]


@dataclass(frozen=True, slots=True)
class _Choice:
    """The cycles that count, and what was decided of the others."""

    cycles: PoseCycles
    sample: Sample
    used: tuple[int, ...]
    excluded: tuple[Exclusion, ...]
    with_excluded: Figures[float | None] | None
    remarks: tuple[Advisory, ...]


def _choose(cycles: PoseCycles, exclude_outliers: bool) -> _Choice:
    whole = sample_of(cycles)
    excluded, remarks = find_outliers(cycles.positions_mm, whole.vectors) if exclude_outliers else ([], [])
    out = {exclusion.index for exclusion in excluded}
    used = tuple(i for i in range(len(cycles)) if i not in out)
    if not out:
        return _Choice(cycles, whole, used, (), None, tuple(remarks))
    rest = cycles.take(np.array(used))
    return _Choice(rest, sample_of(rest), used, tuple(excluded), _raw(whole), tuple(remarks))


_COLUMNS = ("raw", "low", "high", "floor", "corrected", "corrected_low", "corrected_high")


def _assess(samples: list[Sample]) -> list[dict[str, list[float]]]:
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
    # A perfect instrument would not have read more: what rounding or the division by the bias puts above the reading
    # is none of the robot's.
    columns["corrected"] = np.minimum(columns["corrected"], columns["raw"])
    for values in columns.values():
        np.minimum(values[:, 4:], 3.0 * UNKNOWN_ANGLE, out=values[:, 4:])
    rows = zip(*(columns[name].tolist() for name in _COLUMNS), strict=True)
    return [dict(zip(_COLUMNS, row, strict=True)) for row in rows]


def _raw(sample: Sample) -> Figures[float | None]:
    angles = np.minimum(3.0 * np.sqrt(sample.variance[3:]), 3.0 * UNKNOWN_ANGLE)
    values = [sample.reading, *(3.0 * np.sqrt(sample.variance[:3])).tolist()]
    return _figures(values if sample.mean_rotation is None else [*values, *angles.tolist()])


def _conclude(choice: _Choice, table: dict[str, list[float]], limits: Limits) -> PoseRepeatability:
    sample, n = choice.sample, len(choice.cycles)
    known = 4 if sample.mean_rotation is None else 7

    def values(name: str) -> list[float]:
        return table.get(name, [])[:known]

    corrected_interval: list[Interval | None] = list(
        zip(values("corrected_low"), values("corrected_high"), strict=True)
    )
    if table and table["floor"][0] > SOUND_FLOOR * table["raw"][0]:
        corrected_interval[0] = None
    verdicts: list[Verdict] = [
        judge(reading, floor if sample.cycles.covariances is not None else None, n, limits)
        for reading, floor in zip(values("raw"), values("floor"), strict=True)
    ]
    return PoseRepeatability(
        n,
        sample.mean_position,
        sample.mean_rotation,
        None if sample.mean_rotation is None else rotation_to_rpy(sample.mean_rotation),
        _figures(values("raw")),
        _figures(list(zip(values("low"), values("high"), strict=True))),
        _figures(values("floor")),
        _figures(values("corrected")),
        _figures(corrected_interval),
        verdicts[0] if verdicts else Verdict.TOO_FEW_CYCLES,
        _figures(verdicts),
        _orientation(sample),
        choice.used,
        choice.excluded,
        choice.with_excluded,
        choice.remarks + _remarks(sample),
    )


def _figures(known: Sequence[T | None]) -> Figures[T | None]:
    return Figures(*known, *[None] * (len(FIGURE_NAMES) - len(known)))


def _orientation(sample: Sample) -> OrientationScatter | None:
    rotations, mean, vectors = sample.cycles.rotations, sample.mean_rotation, sample.vectors
    if rotations is None or mean is None or vectors is None or len(vectors) < 2:
        return None
    return OrientationScatter(
        _three(three_sigma(vectors)), _three(three_sigma(angles_about_mean(rotations, mean)))
    )


def _remarks(sample: Sample) -> tuple[Advisory, ...]:
    remarks = []
    if sample.cycles.covariances is None:
        remarks.append(
            Advisory(
                "noise_unknown",
                "The poses carry no covariances: the noise floor is taken as zero, and whether the figures speak of "
                "the robot or of the instrument cannot be told.",
                "State the instrument's covariance with each pose.",
            )
        )
    if sample.mean_rotation is not None:
        pitch = float(rotation_to_rpy(sample.mean_rotation)[1])
        if abs(pitch) > math.pi / 2.0 - GIMBAL_MARGIN:
            remarks.append(
                Advisory(
                    "near_gimbal_lock",
                    f"At a pitch of {math.degrees(pitch):.2f}° roll and yaw turn about nearly the same axis, and their "
                    "scatter is magnified.",
                    "Judge the orientation by the rotation vectors, or measure in a frame turned away from it.",
                )
            )
    if len(sample.cycles) > 1 and not sample.variance[:3].any():
        remarks.append(
            Advisory(
                "no_scatter",
                f"All {len(sample.cycles)} cycles read the same position to the last digit.",
                "Check that each cycle was measured anew, and with enough digits.",
            )
        )
    return tuple(remarks)


def _three(values: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
