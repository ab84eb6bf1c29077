"""The section of a repeatability report about what its uncertainties are made of."""

from __future__ import annotations

from app.reports.forms.blocks import Block, heading, number, paragraph, table, with_interval
from app.reports.forms.wording import Json, words

_SKEWED = (
    "RP_l of few cycles and AP_p near its uncertainty are skewed: value ± U then holds the figure less often than k "
    "says, and where it misses RP_l the robot is mostly worse. Quote the interval."
)


def budget_blocks(found: Json) -> list[Block]:
    """Return the section on the budget; none where there is no budget."""
    totals = [
        [
            _of(one),
            *with_interval(one["value_mm"], one.get("interval_mm")),
            number(one["standard_uncertainty_mm"], one["standard_uncertainty_mm"]),
            _freedom(one["degrees_of_freedom"]),
            number(one["coverage_factor"], places=2),
            number(one["expanded_uncertainty_mm"], one["expanded_uncertainty_mm"]),
        ]
        for one in found.get("budget_totals", ())
    ]
    inputs = [
        [
            _of(one),
            words(one["source"]),
            one["type"],
            number(one["standard_uncertainty_mm"], one["standard_uncertainty_mm"]),
            _freedom(one["degrees_of_freedom"]),
            f"{100.0 * one['share']:.1f} %",
        ]
        for one in found.get("budget", ())
    ]
    columns = ("figure", "source", "type", "u, mm", "degrees of freedom", "share")
    level = found["confidence_level"]
    blocks = [
        *table(
            "Combined and expanded uncertainties, mm: U = k u",
            ("figure", "value", f"{100.0 * level:g} % interval", "u", "degrees of freedom", "k", "U"),
            totals,
        ),
        *([paragraph(_SKEWED)] if totals else []),
        *table("What each uncertainty is made of", columns, inputs, text_columns=3),
    ]
    return [heading("Uncertainty budget (GUM)"), *blocks] if blocks else []


def _of(one: Json) -> str:
    """Return which figure of which pose or distance a row of the budget is of."""
    part, _, figure = one["figure"].partition(".")
    symbol = {"rp_l_mm": "RP_l", "ap_p_mm": "AP_p", "ad_mm": "AD"}.get(figure, figure)
    which = {"corrected": ", corrected", "noise_floor": ", floor"}.get(part, "")
    end = f" – {one['to_pose_id']}" if one["to_pose_id"] is not None else ""
    return f"{symbol}{which} {one['pose_id']}{end}"


def _freedom(value: float | None) -> str:
    return "∞" if value is None else number(value, places=1)
