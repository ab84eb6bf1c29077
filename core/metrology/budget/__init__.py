"""Uncertainty budgets of headline figures by the GUM, and their check by sampling (GUM Supplement 1)."""

from core.metrology.budget.combination import Budget, Contribution, Distribution, Evaluation, combined
from core.metrology.budget.figures import (
    FORM_OF_NOISE,
    accuracy_budget,
    corrected_budget,
    distance_budget,
    floor_budget,
    repeatability_budget,
)

__all__ = [
    "FORM_OF_NOISE",
    "Budget",
    "Contribution",
    "Distribution",
    "Evaluation",
    "accuracy_budget",
    "combined",
    "corrected_budget",
    "distance_budget",
    "floor_budget",
    "repeatability_budget",
]
