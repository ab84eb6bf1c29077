"""Performance criteria of ISO 9283:1998, clause 7, exactly as the standard defines them.

n cycles attain positions p_j and angles a_j, b_j, c_j (here roll, pitch, yaw) where p_c, a_c were commanded. Bars are
means over the cycles. Millimetres and radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import InvalidArgument
from core.geometry import rotation_to_rpy, rotation_vectors
from core.metrology.pose_cycles import PerComponent, mean_and_vectors

SMALLEST_DEVIATION = 1e-30
"""What is less is nothing: far below any instrument, and squares of squares stay above the least of floats."""

ROUNDING = 1e-12
"""Readings that differ by less than this share of their size are one reading: of a metre it is a nanometre's
thousandth, which unit conversions and transforms leave.
"""


def deviations(values: Float[np.ndarray, "*b n k"], size: float | None = None) -> Float[np.ndarray, "*b n k"]:
    """Return a_j - ā of each column; exactly zero where the n cycles do not differ beyond rounding.

    `size` is the number that was rounded, the largest of the values of these cycles where None.
    """
    shifted = values - values[..., :1, :]
    about = shifted - shifted.mean(axis=-2, keepdims=True)
    about = np.where(np.abs(about) < SMALLEST_DEVIATION, 0.0, about)
    largest = np.abs(values).max(axis=(-2, -1), keepdims=True, initial=0.0) if size is None else size
    return np.where(np.abs(about).max(axis=-2, keepdims=True) <= ROUNDING * largest, 0.0, about)


def are_unchanging(positions_mm: Float[np.ndarray, "n 3"]) -> bool:
    """Return whether several cycles read one position to the last digit, as no instrument does of a robot."""
    return len(positions_mm) > 1 and not deviations(positions_mm).any()


def position_repeatability(positions_mm: Float[np.ndarray, "n 3"]) -> float:
    """Return RP_l = l̄ + 3 S_l, l_j = ‖p_j - p̄‖, S_l² = Σ (l_j - l̄)² / (n - 1) (7.2.2); n ≥ 2."""
    _at_least_two(len(positions_mm))
    return float(_position_repeatabilities(positions_mm[None])[0])


def _position_repeatabilities(positions_mm: Float[np.ndarray, "b n 3"]) -> Float[np.ndarray, " b"]:
    return rp_of_lengths(np.linalg.norm(deviations(positions_mm), axis=2))


def rp_of_lengths(lengths_mm: Float[np.ndarray, "*k n"]) -> Float[np.ndarray, "*k"]:
    """Return RP_l of the distances l_j of n cycles from their mean."""
    return np.asarray(lengths_mm.mean(axis=-1) + 3.0 * lengths_mm.std(axis=-1, ddof=1))


def rp_of_moments(
    mean_mm: Float[np.ndarray, "*k"], mean_square_mm2: Float[np.ndarray, "*k"]
) -> Float[np.ndarray, "*k"]:
    """Return RP_l of distances with this mean and mean square, as endless cycles have them."""
    return np.asarray(mean_mm + 3.0 * np.sqrt(np.maximum(mean_square_mm2 - mean_mm * mean_mm, 0.0)))


def three_sigma(values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " k"]:
    """Return 3 S of each column, S² = Σ (a_j - ā)² / (n - 1): RP_a, RP_b, RP_c (7.2.2) and RD (7.3.3); n ≥ 2."""
    _at_least_two(len(values))
    d = deviations(values)
    return np.asarray(3.0 * np.sqrt(np.einsum("nk,nk->k", d, d) / (len(values) - 1)))


def pose_accuracy(
    mean_position_mm: Float[np.ndarray, "3"],
    commanded_position_mm: Float[np.ndarray, "3"],
    mean_rotation: Float[np.ndarray, "3 3"] | None = None,
    commanded_rotation: Float[np.ndarray, "3 3"] | None = None,
) -> PerComponent[float | None]:
    """Return AP_p = ‖p̄ - p_c‖ and, signed, attained less commanded on each axis and angle (7.2.1).

    Angles are differences of roll, pitch and yaw taken to (-π, π]; None without both rotations. Both poses must be in
    one frame: the commanded one after the transform between robot and instrument is known.
    """
    d = mean_position_mm - commanded_position_mm
    angles: tuple[float | None, ...] = (None, None, None)
    if mean_rotation is not None and commanded_rotation is not None:
        angles = tuple(_turn(rotation_to_rpy(mean_rotation) - rotation_to_rpy(commanded_rotation)))
    return PerComponent(float(np.linalg.norm(d)), float(d[0]), float(d[1]), float(d[2]), *angles)


def direction_variation(
    mean_positions_mm: Float[np.ndarray, "h 3"], mean_rotations: Float[np.ndarray, "h 3 3"] | None = None
) -> PerComponent[float | None]:
    """Return vAP: the largest differences between the mean poses attained from h directions of approach (7.2.3).

    The standard asks for three directions; two give a lower bound. vAP_p = max ‖p̄_h - p̄_k‖; axes and angles are the
    largest absolute differences.
    """
    if len(mean_positions_mm) < 2:
        raise InvalidArgument(
            "Variation over approach directions needs at least two directions.",
            "Visit the pose from three directions, as the standard asks, and tag each with its approach.",
        )
    h, k = np.triu_indices(len(mean_positions_mm), 1)
    d = mean_positions_mm[h] - mean_positions_mm[k]
    largest = np.abs(d).max(axis=0)
    angles: tuple[float | None, ...] = (None, None, None)
    if mean_rotations is not None:
        rpy = np.array([rotation_to_rpy(R) for R in mean_rotations])
        turns = np.array([_turn(difference) for difference in rpy[h] - rpy[k]])
        angles = tuple(float(a) for a in np.abs(turns).max(axis=0))
    length = float(np.linalg.norm(d, axis=1).max())
    return PerComponent(length, float(largest[0]), float(largest[1]), float(largest[2]), *angles)


@dataclass(frozen=True, slots=True)
class DistancePerformance:
    """AD and RD of the way between two commanded positions, mm."""

    cycles: int
    mean_distance_mm: float
    accuracy_mm: float | None
    repeatability_mm: float | None


def distance_performance(
    first_mm: Float[np.ndarray, "n 3"],
    second_mm: Float[np.ndarray, "m 3"],
    commanded_first_mm: Float[np.ndarray, "3"] | None = None,
    commanded_second_mm: Float[np.ndarray, "3"] | None = None,
) -> DistancePerformance:
    """Return AD_p = D̄ - D_c (7.3.2) and RD = 3 S_D (7.3.3), D_j = ‖p_1j - p_2j‖ within cycle j.

    A length is the same in every frame, so AD_p needs no transform between robot and instrument. Accuracy is None
    without commanded positions, repeatability below two cycles.

    Raises InvalidArgument where the two positions were not visited equally often.
    """
    if len(first_mm) != len(second_mm) or len(first_mm) == 0:
        raise InvalidArgument(
            f"A distance needs both its ends in each cycle; there are {len(first_mm)} and {len(second_mm)}.",
            "Pair the visits by cycle and exclude cycles that miss an end.",
        )
    lengths = np.linalg.norm(first_mm - second_mm, axis=1)
    mean = float(lengths.mean())
    accuracy = None
    if commanded_first_mm is not None and commanded_second_mm is not None:
        accuracy = mean - float(np.linalg.norm(commanded_first_mm - commanded_second_mm))
    repeatability = float(three_sigma(lengths[:, None])[0]) if len(lengths) > 1 else None
    return DistancePerformance(len(lengths), mean, accuracy, repeatability)


@dataclass(frozen=True, slots=True)
class DriftBlock:
    """What a run of consecutive cycles reads: first and last cycle counted from 1, mm and rad.

    `standard_error_mm` is that of the mean position along each axis, of the cycles' scatter.
    """

    first_cycle: int
    last_cycle: int
    mean_position_mm: Float[np.ndarray, "3"]
    standard_error_mm: Float[np.ndarray, "3"]
    repeatability_mm: float


@dataclass(frozen=True, slots=True)
class Drift:
    """dRP and motion between the first and the last block; they need no commanded pose (dAP: `accuracy_drift`).

    `shift_mm` and `shift_rad` are how far the mean pose moved, p̄_T - p̄_1 and log(R̄_T R̄_1ᵀ).
    `shift_rad_standard_error` is of the cycles' scatter.
    """

    blocks: tuple[DriftBlock, ...]
    repeatability_drift_mm: float
    shift_mm: Float[np.ndarray, "3"]
    shift_rad: Float[np.ndarray, "3"] | None
    shift_rad_standard_error: Float[np.ndarray, "3"] | None


@dataclass(frozen=True, slots=True)
class DriftRate:
    """Slope of the position over time by least squares along each axis, mm/h, with its standard error."""

    mm_per_h: Float[np.ndarray, "3"]
    standard_error_mm_per_h: Float[np.ndarray, "3"]


def drift_rate(hours: Float[np.ndarray, " n"], positions_mm: Float[np.ndarray, "n 3"]) -> DriftRate | None:
    """Return how fast the position moved; None below three visits, or where all were at one time.

    The standard error is of visits that scatter independently about a straight line.
    """
    about = hours - hours.mean()
    spread = float(about @ about)
    if len(hours) < 3 or spread == 0.0:
        return None
    off = positions_mm - positions_mm.mean(axis=0)
    rate = about @ off / spread
    left = off - np.outer(about, rate)
    variance = np.einsum("nk,nk->k", left, left) / (len(hours) - 2)
    return DriftRate(np.asarray(rate), np.sqrt(variance / spread))


def drift(
    positions_mm: Float[np.ndarray, "n 3"],
    rotations: Float[np.ndarray, "n 3 3"] | None = None,
    block: int = 10,
    step_mm: Float[np.ndarray, "3"] | None = None,
) -> Drift:
    """Return dRP = |RP_1 - RP_T| and the motion (7.6) over blocks of consecutive cycles from a cold start.

    Cycles in the order they were made. Those that fill no whole block join the last one. `step_mm` is the resolution of
    the readings, 0 along axes where none shows: where a block scatters by less than half of it, the standard error of
    its mean holds what rounding leaves, step / √12.

    Raises InvalidArgument where there are fewer cycles than two blocks.
    """
    count = len(positions_mm) // max(block, 1)
    if block < 2 or count < 2:
        raise InvalidArgument(
            f"Drift needs two blocks of {block} cycles; there are {len(positions_mm)} cycles.",
            "Run more cycles, or choose shorter blocks of at least two.",
        )
    starts = [i * block for i in range(count)]
    ends = [*starts[1:], len(positions_mm)]
    # Blocks of one length together: there may be hundreds.
    parts = (positions_mm[: starts[-1]].reshape(count - 1, block, 3), positions_mm[None, starts[-1] :])
    mean = np.concatenate([part.mean(axis=1) for part in parts])
    spread = np.concatenate([part.std(axis=1, ddof=1) for part in parts])
    error = spread / np.sqrt(np.subtract(ends, starts))[:, None]
    if step_mm is not None:
        error = np.where(spread < 0.5 * step_mm, np.hypot(error, step_mm / math.sqrt(12.0)), error)
    readings = np.concatenate([_position_repeatabilities(part) for part in parts]).tolist()
    blocks = [
        DriftBlock(start + 1, end, *figures)
        for start, end, *figures in zip(starts, ends, mean, error, readings, strict=True)
    ]
    first, last = blocks[0], blocks[-1]
    turned = turned_error = None
    if rotations is not None:
        first_rotation, first_vectors = mean_and_vectors(rotations[: ends[0]])
        last_rotation, last_vectors = mean_and_vectors(rotations[starts[-1] :])
        turned = rotation_vectors(last_rotation[None], first_rotation)[0]
        turned_error = np.hypot(
            *(v.std(axis=0, ddof=1) / math.sqrt(len(v)) for v in (first_vectors, last_vectors))
        )
    return Drift(
        tuple(blocks),
        abs(first.repeatability_mm - last.repeatability_mm),
        last.mean_position_mm - first.mean_position_mm,
        turned,
        turned_error,
    )


def length_standard_error(vector: Float[np.ndarray, "3"], error: Float[np.ndarray, "3"]) -> float:
    """Return the standard error of a vector's length from those along the axes: that along the vector; of none, the
    largest.
    """
    length = float(np.linalg.norm(vector))
    return float(np.linalg.norm(vector * error)) / length if length > 0.0 else float(error.max())


def shift_degrees_of_freedom(found: Drift) -> tuple[Float[np.ndarray, "3"], float]:
    """Return the effective degrees of freedom of the shift's standard errors along the axes, and of its length's.

    By Welch and Satterthwaite (JCGM 100:2008, G.2b); a block has one less than its cycles. Without scatter: of both.
    """
    both = (found.blocks[0], found.blocks[-1])
    own = np.array([[float(one.last_cycle - one.first_cycle)] for one in both])
    variances = np.array([one.standard_error_mm for one in both]) ** 2

    def effective(weights: Float[np.ndarray, "3"]) -> float:
        parts = weights * variances
        spread = float(np.sum(parts**2 / own))
        return float(parts.sum()) ** 2 / spread if spread > 0.0 else float(own.sum())

    along = found.shift_mm**2
    if not along.any():  # as `length_standard_error`
        along = np.eye(3)[variances.sum(axis=0).argmax()]
    return np.array([effective(axis) for axis in np.eye(3)]), effective(along)


def _at_least_two(n: int) -> None:
    if n < 2:
        raise InvalidArgument(
            "Scatter needs at least two cycles.", "Visit the pose again: 30 cycles are the standard."
        )


def _turn(difference: Float[np.ndarray, "3"]) -> list[float]:
    return [float(math.pi - (math.pi - a) % (2.0 * math.pi)) for a in difference]
