"""Distances between poses, and variation over approaches, each figure with its uncertainty.

Readings p_1j, p_2j of cycle j have covariances M_1j, M_2j, of what differs from cycle to cycle. The distance D_j
scatters with the robot's part and eᵀ (M_1j + M_2j) e, e its direction; that is one quantity, so that its 3 S has the
interval and the floor of any (`uncertainty`), moved as cycles that correlate need it (`cycle_process`). The distance's
mean is as uncertain as S_D / √n, times what correlation adds, and what all readings have in common leave it: c_1, c_2
being what one standard uncertainty of each common error does to the two positions, ‖eᵀ (c_1 - c_2)‖.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri, stdtrit

from core.errors import InvalidArgument
from core.geometry import so3_log
from core.metrology.cycle_process import CycleProcess, mean_of_cycles, shift_of_three_sigma
from core.metrology.iso9283 import (
    DistancePerformance,
    direction_variation,
    distance_performance,
    three_sigma,
)
from core.metrology.pose_cycles import (
    COMPONENTS,
    UNKNOWN_ANGLE,
    PerComponent,
    PoseCycles,
    angles_from_vectors,
    mean_and_vectors,
)
from core.metrology.repeatability import IntervalEstimate, assess_three_sigma, cycle_statistics
from core.metrology.rp_distribution import CONFIDENCE

FAR_ENOUGH = 20.0
"""A distance shorter than this many of its own standard deviations does not scatter along its direction alone."""
SAME_COMMANDED, SAME_MEASURED = math.radians(0.001), math.radians(0.1)
"""Turn up to which two orientations are the same."""
_DRAWS = 1000
_SEED = 9283

RotationPair = tuple[Float[np.ndarray, "3 3"] | None, Float[np.ndarray, "3 3"] | None]


@dataclass(frozen=True, slots=True)
class DistanceAssessment:
    """AD and RD of one way, mm. `standard_uncertainty_mm` is the mean distance's, of the readings; `interval_mm` and
    `noise_floor_mm` are RD's, as those of any 3 S; `accuracy_interval_mm` is AD's: t of its scatter and the normal
    quantile of what all readings have in common. `cycles_uncertainty_mm` is the mean's standard uncertainty by the
    cycles alone, of `degrees_of_freedom`; `common_mm` is what one standard uncertainty of each error that all readings
    share does to the mean. None below two cycles, the floor also where nothing is known of the instrument, `common_mm`
    where that is not known.
    """

    performance: DistancePerformance
    standard_uncertainty_mm: float | None
    interval_mm: tuple[float, float] | None
    noise_floor_mm: float | None
    accuracy_interval_mm: tuple[float, float] | None = None
    cycles_uncertainty_mm: float | None = None
    degrees_of_freedom: float | None = None
    common_mm: Float[np.ndarray, " k"] | None = None


def same_orientation(commanded: RotationPair, measured: RotationPair) -> bool:
    """Return whether two poses have one orientation: as commanded, else as measured; True if unknown.

    Parameters
    ----------
    commanded, measured: of both poses the rotation (3, 3) in the frame of either, None where it is not known.
    """
    for (one, other), largest in ((commanded, SAME_COMMANDED), (measured, SAME_MEASURED)):
        if one is not None and other is not None:
            return float(np.linalg.norm(so3_log(one.T @ other))) <= largest
    return True


def assess_distance(
    first: PoseCycles,
    second: PoseCycles,
    commanded_first_mm: Float[np.ndarray, "3"] | None = None,
    commanded_second_mm: Float[np.ndarray, "3"] | None = None,
    common_first: Float[np.ndarray, "6 k"] | None = None,
    common_second: Float[np.ndarray, "6 k"] | None = None,
    process: CycleProcess | None = None,
) -> DistanceAssessment:
    """Return distance accuracy and repeatability (ISO 9283:1998, 7.3.2, 7.3.3) of cycles that visit both poses.

    `first` and `second` hold the same cycles in the same order. `common_...` are what one standard uncertainty of each
    error that all readings share does to the poses, of which positions come first. `process` is what cycles follow,
    None for independent Gaussian ones.

    Raises InvalidArgument where the poses were not visited equally often, or lie so near to one another that a distance
    between them means nothing.
    """
    performance = distance_performance(
        first.positions_mm, second.positions_mm, commanded_first_mm, commanded_second_mm
    )
    way = second.positions_mm - first.positions_mm
    lengths = np.linalg.norm(way, axis=1)
    if len(lengths) < 2:
        return DistanceAssessment(performance, None, None, None)
    scatter = max(float(np.max(three_sigma(way))), float(np.max(three_sigma(lengths[:, None])))) / 3.0
    if float(lengths.mean()) <= FAR_ENOUGH * scatter:
        raise InvalidArgument(
            f"The two poses are {lengths.mean():.3g} mm apart and scatter by {scatter:.3g} mm: that is no distance.",
            "Choose two poses of the cube that lie far apart, as the standard does.",
        )
    e = way / lengths[:, None]
    n = len(lengths)
    variance = float(np.var(lengths, ddof=1))
    noise = np.zeros(n)
    for cycles in (first, second):
        if cycles.covariances is not None:
            noise += np.einsum("ni,nij,nj->n", e, cycles.covariances[:, :3, :3], e)
    known = first.covariances is not None and second.covariances is not None
    assessed = assess_three_sigma(
        np.array([[variance]]),
        np.array([[noise.mean()]]),
        np.array([[np.mean(noise * noise)]]),
        np.array([float(n)]),
    )
    columns = None
    if common_first is not None and common_second is not None:
        columns = e.mean(axis=0) @ (common_second - common_first)[:3]
    common = 0.0 if columns is None else float(np.linalg.norm(columns))
    accuracy = performance.accuracy_mm
    mean = mean_of_cycles(process, n)
    of_cycles = mean.inflation * math.sqrt(variance / n)
    confident = 0.5 + 0.5 * CONFIDENCE
    half = math.hypot(
        float(stdtrit(mean.degrees_of_freedom, confident)) * of_cycles, float(ndtri(confident)) * common
    )
    return DistanceAssessment(
        performance,
        math.hypot(of_cycles, common),
        _interval(assessed, 3.0 * math.sqrt(variance), process, n),
        float(assessed.floor[0, 0]) if known else None,
        None if accuracy is None else (accuracy - half, accuracy + half),
        of_cycles,
        mean.degrees_of_freedom,
        columns,
    )


def _interval(
    assessed: IntervalEstimate, reading: float, process: CycleProcess | None, cycles: int
) -> tuple[float, float]:
    """Return the interval of RD, moved to where cycles of this process have it."""
    low, high = float(assessed.low[0, 0]), float(assessed.high[0, 0])
    if process is not None:
        shift = shift_of_three_sigma(process, cycles)
        low, high = low * math.exp(float(shift.low[0])), high * math.exp(float(shift.high[0]))
    return min(low, reading), max(high, reading)


@dataclass(frozen=True, slots=True)
class ApproachVariation:
    """vAP, mm and rad, and what the cycles' own scatter would make of it were the direction without effect: of means
    of so many cycles, the expected largest difference. None where no direction has two cycles.
    """

    figures: PerComponent[float | None]
    noise_floor: PerComponent[float | None]


def assess_approaches(directions: Sequence[PoseCycles]) -> ApproachVariation:
    """Return vAP (ISO 9283:1998, 7.2.3) of one commanded pose approached from several directions, at least two."""
    samples = [cycle_statistics(cycles) for cycles in directions]
    rotations = [s.mean_rotation for s in samples if s.mean_rotation is not None]
    turned = len(rotations) == len(samples)
    figures = direction_variation(
        np.array([s.mean_position for s in samples]), np.array(rotations) if turned else None
    )
    nothing: PerComponent[float | None] = PerComponent(*[None] * len(COMPONENTS))
    counts = np.array([len(s.cycles) for s in samples])
    if not np.any(counts > 1):
        return ApproachVariation(figures, nothing)
    to_angles = np.eye(3)
    if turned:
        mean, _ = mean_and_vectors(np.array(rotations))
        to_angles = angles_from_vectors(mean)
    scatter = np.zeros((6, 6))
    for s in samples:
        about = np.zeros((len(s.cycles), 6))
        about[:, :3] = s.cycles.positions_mm - s.mean_position
        if turned and s.vectors is not None:
            about[:, 3:] = s.vectors @ to_angles.T
        scatter += about.T @ about
    scatter /= float(np.sum(counts - 1))
    values, vectors = np.linalg.eigh(scatter)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = np.random.default_rng(_SEED).standard_normal((_DRAWS, len(samples), 6)) @ root.T
    draws /= np.sqrt(counts)[:, None]
    h, k = np.triu_indices(len(samples), 1)
    d = draws[:, h] - draws[:, k]
    expected = np.abs(d).max(axis=1).mean(axis=0)
    length = float(np.linalg.norm(d[..., :3], axis=2).max(axis=1).mean())
    angles = np.minimum(expected[3:], 3.0 * UNKNOWN_ANGLE).tolist() if turned else [None] * 3
    return ApproachVariation(figures, PerComponent(length, *expected[:3].tolist(), *angles))
