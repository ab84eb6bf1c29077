"""Law of propagation of uncertainty, effective degrees of freedom, and how far sampling the inputs agrees.

A figure y = f(x_1, ..., x_N) has the combined standard uncertainty u_c² = Σ (c_i u_i)², c_i = ∂f/∂x_i, for inputs that
do not depend on one another, the effective degrees of freedom ν = u_c⁴ / Σ (c_i u_i)⁴ / ν_i (Welch-Satterthwaite), and
the expanded uncertainty U = k u_c, k = t_ν at `CONFIDENCE`.

Sampling takes a draw of every input through f itself. It agrees with y ± U where both ends lie within δ of its
quantiles, δ = ½ 10^r for u_c written as c 10^r with one digit c.

References: JCGM 100:2008 (GUM), 5.1.2, G.4.1; JCGM 101:2008 (GUM Supplement 1), 7.7, 8.1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri, stdtrit

from core.metrology.rp_distribution import CONFIDENCE


class Evaluation(StrEnum):
    """By what an uncertainty is known: `A`, a series of observations; `B`, anything else."""

    A = "A"
    B = "B"


class Distribution(StrEnum):
    """What is assigned to an input."""

    NORMAL = "normal"
    STUDENT = "student_t"
    SCATTER = "long_run_scatter"
    """Of a long-run figure of scatter, given that of n cycles."""


@dataclass(frozen=True, slots=True)
class Contribution:
    """One input: its standard uncertainty in `unit` (`mm`, or `1` for a relative one), and the figure's sensitivity, mm
    per unit. `degrees_of_freedom` None: of a stated uncertainty, or of one from very many observations.
    """

    source: str
    evaluation: Evaluation
    distribution: Distribution
    input_uncertainty: float
    unit: str
    sensitivity: float
    degrees_of_freedom: float | None = None

    @property
    def standard_uncertainty_mm(self) -> float:
        """What it adds to the figure, |c_i| u_i."""
        return abs(self.sensitivity) * self.input_uncertainty


@dataclass(frozen=True, slots=True)
class Agreement:
    """What sampling gave: standard deviation and 95 % interval, mm, and the larger distance of its ends from those of
    y ± U, with the tolerance δ.
    """

    trials: int
    standard_uncertainty_mm: float
    interval_mm: tuple[float, float]
    difference_mm: float
    tolerance_mm: float

    @property
    def agrees(self) -> bool:
        return self.difference_mm <= self.tolerance_mm


@dataclass(frozen=True, slots=True)
class Budget:
    """The budget of one figure; mm. `effective_degrees_of_freedom` None: infinite."""

    value_mm: float
    contributions: tuple[Contribution, ...]
    standard_uncertainty_mm: float
    effective_degrees_of_freedom: float | None
    coverage_factor: float
    agreement: Agreement | None = None

    @property
    def expanded_uncertainty_mm(self) -> float:
        return self.coverage_factor * self.standard_uncertainty_mm

    def share(self, contribution: Contribution) -> float:
        """Return a contribution's share of the combined variance; 0 where nothing is uncertain."""
        whole = self.standard_uncertainty_mm
        return (contribution.standard_uncertainty_mm / whole) ** 2 if whole > 0.0 else 0.0


def combined(
    value_mm: float, contributions: Sequence[Contribution], draws_mm: Float[np.ndarray, " t"] | None = None
) -> Budget:
    """Return the budget of a figure whose inputs do not depend on one another.

    `draws_mm` are of the figure, by sampling its inputs; without them it is not sampled.
    """
    squares = [one.standard_uncertainty_mm**2 for one in contributions]
    variance = math.fsum(squares)
    weighted = math.fsum(
        square * square / one.degrees_of_freedom
        for square, one in zip(squares, contributions, strict=True)
        if one.degrees_of_freedom is not None
    )
    freedom = variance * variance / weighted if weighted > 0.0 else None
    level = 0.5 + 0.5 * CONFIDENCE
    factor = float(ndtri(level) if freedom is None else stdtrit(freedom, level))
    budget = Budget(value_mm, tuple(contributions), math.sqrt(variance), freedom, factor)
    if draws_mm is None:
        return budget
    low, high = np.quantile(draws_mm, [1.0 - level, level]).tolist()
    half = budget.expanded_uncertainty_mm
    difference = max(abs(value_mm - half - low), abs(value_mm + half - high))
    agreement = Agreement(
        len(draws_mm),
        float(np.std(draws_mm)),
        (low, high),
        difference,
        _tolerance(budget.standard_uncertainty_mm),
    )
    return Budget(value_mm, budget.contributions, budget.standard_uncertainty_mm, freedom, factor, agreement)


def _tolerance(uncertainty: float) -> float:
    """Return δ: half of the last place of an uncertainty with one significant digit."""
    if uncertainty <= 0.0:
        return 0.0
    # Written with one digit .0096 is .01, whose last place is a hundredth.
    return 0.5 * 10.0 ** math.floor(math.log10(float(f"{uncertainty:.0e}")))
