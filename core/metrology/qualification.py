"""Qualification of a measuring set-up by known lengths: errors of length, scatter of probing, and the scale they show.

A length is the distance of two mean positions; its error is what is measured less the calibrated length. The
uncertainty of the test value is the calibrated length's and that of the means, and nothing of the instrument's own:
print, lens and temperature are what the test is about. A limit (maximum permissible error) is kept where every error
and its 95 % uncertainty lie within it, exceeded where one lies beyond it. One of m is enough for that, so that each is
judged at the m-th part of the risk, as poses are in `acceptance`.

The scale is the slope of the errors over the lengths, by generalised least squares: lengths that begin at one pose have
the error of its mean in common. What the visits scatter is taken as one of all poses, and drawn towards one that is
equal in all directions, so that few visits weigh rightly: least squares prefer what happened to scatter little.

References: VDI/VDE 2634 part 1 (length measurement error); ASTM E2919 (pose measurement systems); ISO/TS 23165:2006
(test value uncertainty); ISO 14253-1:2017.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from core.errors import InvalidArgument
from core.metrology.acceptance import Decision
from core.metrology.pose_cycles import PoseCycles
from core.metrology.rp_distribution import CONFIDENCE

_MANY = 1e6
"""Degrees of freedom of a stated uncertainty."""
_EQUAL_DIRECTIONS = 4.0
"""Degrees of freedom as which a scatter equal in all directions counts."""


@dataclass(frozen=True, slots=True)
class KnownLength:
    """A calibrated length between two poses, mm, with its standard uncertainty."""

    from_pose_id: str
    to_pose_id: str
    length_mm: float
    standard_uncertainty_mm: float

    def __post_init__(self) -> None:
        if not (0.0 < self.length_mm < math.inf and 0.0 <= self.standard_uncertainty_mm < math.inf):
            raise InvalidArgument(
                f"The length from {self.from_pose_id} to {self.to_pose_id} must be longer than 0 mm, its uncertainty "
                "not below 0."
            )
        if self.from_pose_id == self.to_pose_id:
            raise InvalidArgument(f"A length leads from {self.from_pose_id} to itself.", "Name two poses.")


@dataclass(frozen=True, slots=True)
class LengthError:
    """Error of one length, mm: measured less calibrated, with the test value's uncertainty, its effective degrees of
    freedom and its 95 % interval.
    """

    known: KnownLength
    measured_mm: float
    error_mm: float
    standard_uncertainty_mm: float
    degrees_of_freedom: float
    interval_mm: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Qualification:
    """What known lengths show.

    `probing_scatter_mm` is the largest distance of a visit from the mean of its pose, None where no pose has two.
    `scale_ppm` is by how much lengths are measured too long, with its standard uncertainty. `decision` is on the
    maximum permissible error, None where none is stated.
    """

    errors: tuple[LengthError, ...]
    probing_scatter_mm: float | None
    scale_ppm: float
    scale_standard_uncertainty_ppm: float
    decision: Decision | None

    @property
    def worst(self) -> LengthError:
        return max(self.errors, key=lambda one: abs(one.error_mm))


def qualify(
    lengths: Sequence[tuple[KnownLength, PoseCycles, PoseCycles]],
    maximum_permissible_error_mm: float | None = None,
) -> Qualification:
    """Compare calibrated lengths with the distances of the poses' mean positions.

    Each length comes with the visits to the pose where it begins and to that where it ends. Raises InvalidArgument
    without lengths, and for a pose of one visit whose covariance is not stated.
    """
    if not lengths:
        raise InvalidArgument("A qualification needs a known length.", "State one between two of the poses.")
    errors = tuple(_compared(*one) for one in lengths)
    poses = {id(cycles): cycles for _, *both in lengths for cycles in both}
    scatter = [
        float(np.linalg.norm(cycles.positions_mm - cycles.positions_mm.mean(axis=0), axis=1).max())
        for cycles in poses.values()
        if len(cycles) > 1
    ]
    length = np.array([one.known.length_mm for one in errors])
    weighted = np.linalg.pinv(_covariance(lengths), hermitian=True) @ length
    information = float(weighted @ length)
    scale = float(weighted @ [one.error_mm for one in errors]) / information
    return Qualification(
        errors,
        max(scatter, default=None),
        1e6 * scale,
        1e6 / math.sqrt(information),
        None if maximum_permissible_error_mm is None else _decided(errors, maximum_permissible_error_mm),
    )


def _covariance(
    lengths: Sequence[tuple[KnownLength, PoseCycles, PoseCycles]],
) -> Float[np.ndarray, "l l"]:
    """Return the covariance of the errors, mm²: of the calibrated lengths, and of the means that lengths share."""
    poses = list({id(cycles): cycles for _, *both in lengths for cycles in both}.values())
    place = {id(cycles): 3 * i for i, cycles in enumerate(poses)}
    ways = np.zeros((len(lengths), 3 * len(poses)))
    for row, (_, first, second) in zip(ways, lengths, strict=True):
        way = second.positions_mm.mean(axis=0) - first.positions_mm.mean(axis=0)
        row[place[id(first)] : place[id(first)] + 3] = -way / np.linalg.norm(way)
        row[place[id(second)] : place[id(second)] + 3] = way / np.linalg.norm(way)
    freedom = sum(len(cycles) - 1 for cycles in poses)
    squares = [np.cov(cycles.positions_mm.T) * (len(cycles) - 1) for cycles in poses if len(cycles) > 1]
    total = np.sum(squares, axis=0) if squares else np.zeros((3, 3))
    equal = np.trace(total) / 3.0 / max(freedom, 1) * np.eye(3)
    scatter = (total + _EQUAL_DIRECTIONS * equal) / (freedom + _EQUAL_DIRECTIONS)
    of_means = np.zeros((3 * len(poses),) * 2)
    for i, cycles in zip(place.values(), poses, strict=True):
        own = cycles.covariances[0, :3, :3] if cycles.covariances is not None else scatter
        of_means[i : i + 3, i : i + 3] = scatter / len(cycles) if len(cycles) > 1 else own
    stated = np.diag([known.standard_uncertainty_mm**2 for known, *_ in lengths])
    return np.asarray(stated + ways @ of_means @ ways.T)


def _compared(known: KnownLength, first: PoseCycles, second: PoseCycles) -> LengthError:
    way = second.positions_mm.mean(axis=0) - first.positions_mm.mean(axis=0)
    measured = float(np.linalg.norm(way))
    if measured == 0.0:
        raise InvalidArgument(
            f"Poses {known.from_pose_id} and {known.to_pose_id} were measured at the same place."
        )
    variances = [(known.standard_uncertainty_mm**2, _MANY)]
    variances += [_variance_of_mean(cycles, way / measured) for cycles in (first, second)]
    variance = sum(v for v, _ in variances)
    if variance == 0.0:
        raise InvalidArgument(
            f"Nothing is known of the uncertainty from {known.from_pose_id} to {known.to_pose_id}.",
            "State the length's standard uncertainty, or visit the poses again.",
        )
    # Welch-Satterthwaite (GUM, G.4.1).
    freedom = variance**2 / sum(v * v / nu for v, nu in variances)
    error, half = (
        measured - known.length_mm,
        math.sqrt(variance) * float(stdtrit(freedom, 0.5 + CONFIDENCE / 2.0)),
    )
    return LengthError(known, measured, error, math.sqrt(variance), freedom, (error - half, error + half))


def _variance_of_mean(cycles: PoseCycles, direction: np.ndarray) -> tuple[float, float]:
    """Return the variance of the mean position along a direction, mm², and its degrees of freedom."""
    n = len(cycles)
    if n > 1:
        return float(np.var(cycles.positions_mm @ direction, ddof=1)) / n, n - 1.0
    if cycles.covariances is None:
        raise InvalidArgument(
            "A pose has one visit, and the instrument's covariance is not stated.",
            "Visit each pose at least twice.",
        )
    return float(direction @ cycles.covariances[0, :3, :3] @ direction), _MANY


def _decided(errors: Sequence[LengthError], limit_mm: float) -> Decision:
    part = (1.0 - CONFIDENCE) / (2.0 * len(errors))
    if any(abs(one.error_mm) - _half_width(one, part) > limit_mm for one in errors):
        return Decision.FAIL
    within = all(-limit_mm <= low and high <= limit_mm for low, high in (one.interval_mm for one in errors))
    return Decision.PASS if within else Decision.INCONCLUSIVE


def _half_width(one: LengthError, risk: float) -> float:
    """Return by how much the error is exceeded with this risk, mm."""
    return one.standard_uncertainty_mm * float(stdtrit(one.degrees_of_freedom, 1.0 - risk))
