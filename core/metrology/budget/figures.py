"""Budgets of RP_l as read and corrected, of the noise floor, AP and AD: which inputs each has, and its model.

With s the relative error of the print's scale, n_1 and n_2 relative errors of the size and of the form of the noise:

- RP_l: v = g / (1 + s), g the long-run figure given that of n cycles;
- the noise floor: f = f_0 (1 + n_1) (1 + n_2) / (1 + s);
- RP_l corrected: c = √(v² - f²), so that ∂c/∂v = v/c, ∂c/∂f = -f/c;
- AP: ‖e‖ of the deviation e of `core.metrology.accuracy`, its inputs taken along e;
- AD: the mean distance less the commanded one, its inputs taken along the way.

The lens as well as scale and shape of the print are corrections of expectation 0 (GUM 4.1.2, note).
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.metrology.accuracy import DeviationParts
from core.metrology.budget.combination import Budget, Contribution, Distribution, Evaluation, combined
from core.metrology.distances import DistanceAssessment
from core.metrology.rp_distribution import NORMAL_FACTOR

FORM_OF_NOISE = 0.07
"""Relative standard uncertainty of a floor by the form of the noise: rms of ln(floor stated / floor read) over the
disturbances of the benchmark `trust` (white, correlated, waves, bursts, blur)."""
_SHARED = {"lens": Evaluation.A, "print_scale": Evaluation.B, "print_shape": Evaluation.B}
Draws = Float[np.ndarray, " t"]


def repeatability_budget(
    reading_mm: float, interval_mm: tuple[float, float], scale: float | None, long_run_mm: Draws | None
) -> Budget:
    """Return the budget of RP_l as read.

    `interval_mm` is its 95 % interval; `scale` the relative standard uncertainty of the print's scale, None where it is
    not stated; `long_run_mm` are draws of the long-run figure, None where it is not sampled.
    """
    found = [_cycles(reading_mm, interval_mm, 1.0), *_scale(scale, reading_mm)]
    return combined(reading_mm, found, None if long_run_mm is None else _scaled(long_run_mm, scale))


def floor_budget(floor_mm: float, freedom: int, scale: float | None, trials: int | None) -> Budget:
    """Return the budget of the noise floor of images, of which `freedom` deviate from their pose's mean image."""
    found = [*_noise(floor_mm, freedom, 1.0), *_scale(scale, floor_mm)]
    return combined(
        floor_mm, found, None if trials is None else _scaled(_floors(floor_mm, freedom, trials), scale)
    )


def corrected_budget(
    corrected_mm: float,
    reading_mm: float,
    interval_mm: tuple[float, float],
    floor_mm: float,
    freedom: int | None,
    scale: float | None,
    long_run_mm: Draws | None,
) -> Budget:
    """Return the budget of RP_l corrected, larger than 0.

    `freedom` None: nothing is known of the floor's uncertainty.
    """
    found = [_cycles(reading_mm, interval_mm, reading_mm / corrected_mm)]
    if freedom is not None:
        found += _noise(floor_mm, freedom, -floor_mm / corrected_mm)
    found += _scale(scale, corrected_mm)
    if long_run_mm is None:
        return combined(corrected_mm, found)
    floors: Draws | float = floor_mm if freedom is None else _floors(floor_mm, freedom, len(long_run_mm))
    # The corrected reading also corrects what few cycles read too little or too much.
    bias = corrected_mm / math.sqrt(max(reading_mm**2 - floor_mm**2, corrected_mm**2 * 1e-6))
    left = bias * np.sqrt(np.maximum(long_run_mm**2 - floors**2, 0.0))
    return combined(corrected_mm, found, _scaled(left, scale))


def accuracy_budget(
    value_mm: float, parts: DeviationParts, sources: tuple[str, ...], trials: int | None
) -> Budget:
    """Return the budget of AP_p; `sources` says of what each column of `parts.shared` is."""
    length = float(np.linalg.norm(parts.residual))
    along = parts.residual / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
    tie, visits = (math.sqrt(max(float(along @ C @ along), 0.0)) for C in (parts.of_tie, parts.of_visits))
    found = [
        Contribution(
            "frame_tie", Evaluation.A, Distribution.STUDENT, tie, "mm", 1.0, parts.degrees_of_freedom
        ),
        Contribution(
            "mean_of_visits",
            Evaluation.A if parts.visits_degrees_of_freedom is not None else Evaluation.B,
            Distribution.NORMAL,
            visits,
            "mm",
            1.0,
            parts.visits_degrees_of_freedom,
        ),
        *_shared(along @ parts.shared, sources, None),
    ]
    return combined(value_mm, found, None if trials is None else parts.lengths(trials))


def distance_budget(found: DistanceAssessment, sources: tuple[str, ...], trials: int | None) -> Budget | None:
    """Return the budget of AD; None where nothing was commanded, or below two cycles."""
    value, u, freedom = found.performance.accuracy_mm, found.cycles_uncertainty_mm, found.degrees_of_freedom
    if value is None or u is None or freedom is None:
        return None
    inputs = [Contribution("cycles", Evaluation.A, Distribution.STUDENT, u, "mm", 1.0, freedom)]
    if found.common_mm is not None:
        inputs += _shared(found.common_mm, sources, found.performance.mean_distance_mm)
    if trials is None:
        return combined(value, inputs)
    rng = _rng()
    draws = value + u * rng.standard_t(freedom, trials)
    if found.common_mm is not None:
        draws = draws + rng.standard_normal((trials, len(found.common_mm))) @ found.common_mm
    return combined(value, inputs, draws)


def _cycles(reading_mm: float, interval_mm: tuple[float, float], sensitivity: float) -> Contribution:
    """Return what a finite number of cycles leaves open, by the interval of the figure.

    The logarithm of a scatter from ν degrees of freedom has the variance 1 / 2ν.
    """
    low, high = (max(bound, 1e-6 * reading_mm) for bound in interval_mm)
    spread = math.log(high / low) / (2.0 * NORMAL_FACTOR)
    return Contribution(
        "cycles",
        Evaluation.A,
        Distribution.SCATTER,
        reading_mm * spread,
        "mm",
        sensitivity,
        max(0.5 / spread**2, 1.0) if spread > 0.0 else None,
    )


def _noise(floor_mm: float, freedom: int, sensitivity: float) -> list[Contribution]:
    """Return size and form of the noise: its size is known from one contrast of every image at least."""
    relative = 1.0 / math.sqrt(2.0 * freedom)
    size = Contribution(
        "noise_size",
        Evaluation.A,
        Distribution.SCATTER,
        relative,
        "1",
        sensitivity * floor_mm,
        float(freedom),
    )
    form = Contribution(
        "noise_form", Evaluation.B, Distribution.NORMAL, FORM_OF_NOISE, "1", sensitivity * floor_mm
    )
    return [size, form]


def _scale(scale: float | None, value_mm: float) -> list[Contribution]:
    if scale is None:
        return []
    return [Contribution("print_scale", Evaluation.B, Distribution.NORMAL, scale, "1", value_mm)]


def _shared(
    columns_mm: Float[np.ndarray, " e"], sources: tuple[str, ...], length_mm: float | None
) -> list[Contribution]:
    """Return what lens, scale and shape of the print leave open; scale as a relative one of a length."""
    found = []
    for source, evaluation in _SHARED.items():
        of_source = np.array([one == source for one in sources], dtype=np.bool_)
        if not of_source.any():
            continue
        u = float(np.linalg.norm(columns_mm[of_source]))
        relative = source == "print_scale" and length_mm is not None
        unit, sensitivity = ("1", length_mm or 1.0) if relative else ("mm", 1.0)
        found.append(
            Contribution(source, evaluation, Distribution.NORMAL, u / sensitivity, unit, sensitivity)
        )
    return found


def _floors(floor_mm: float, freedom: int, trials: int) -> Draws:
    rng = _rng()
    size = np.sqrt(freedom / rng.chisquare(freedom, trials))
    return np.asarray(floor_mm * size * (1.0 + FORM_OF_NOISE * rng.standard_normal(trials)))


def _scaled(values_mm: Draws, scale: float | None) -> Draws:
    if scale is None:
        return values_mm
    return np.asarray(
        values_mm * (1.0 + scale * np.random.default_rng(_SEED + 1).standard_normal(len(values_mm)))
    )


_SEED = 101


def _rng() -> np.random.Generator:
    return np.random.default_rng(_SEED)
