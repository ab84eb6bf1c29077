"""Uncertainty budgets of a session's figures as the API shows them: a row an input, and a row a figure."""

from __future__ import annotations

from typing import Any

from core.session import FigureBudget, SessionBudgets


def budget_fields(found: SessionBudgets) -> dict[str, Any]:
    """Return `budget`, a row for each input of each figure, and `budget_totals`, a row for each figure."""
    return {
        "budget": [row for one in found.budgets for row in _inputs(one)],
        "budget_totals": [_total(one) for one in found.budgets],
    }


def _figure(one: FigureBudget) -> dict[str, Any]:
    return {"figure": one.figure, "pose_id": one.pose_id, "to_pose_id": one.to_pose_id}


def _inputs(one: FigureBudget) -> list[dict[str, Any]]:
    return [
        {
            **_figure(one),
            "source": part.source,
            "type": part.evaluation,
            "distribution": part.distribution,
            "input_uncertainty": part.input_uncertainty,
            "input_unit": part.unit,
            "sensitivity": part.sensitivity,
            "standard_uncertainty_mm": part.standard_uncertainty_mm,
            "degrees_of_freedom": part.degrees_of_freedom,
            "share": one.budget.share(part),
        }
        for part in one.budget.contributions
    ]


def _total(one: FigureBudget) -> dict[str, Any]:
    budget, agreement = one.budget, one.budget.agreement
    return {
        **_figure(one),
        "value_mm": budget.value_mm,
        "standard_uncertainty_mm": budget.standard_uncertainty_mm,
        "degrees_of_freedom": budget.effective_degrees_of_freedom,
        "coverage_factor": budget.coverage_factor,
        "expanded_uncertainty_mm": budget.expanded_uncertainty_mm,
        "interval_mm": None if one.interval_mm is None else list(one.interval_mm),
        "monte_carlo": agreement
        and {
            "trials": agreement.trials,
            "standard_uncertainty_mm": agreement.standard_uncertainty_mm,
            "interval_mm": list(agreement.interval_mm),
            "difference_mm": agreement.difference_mm,
            "tolerance_mm": agreement.tolerance_mm,
            "agrees": agreement.agrees,
        },
    }
