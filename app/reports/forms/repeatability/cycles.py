"""Sections of a repeatability report about its cycles in their order: drift, steadiness."""

from __future__ import annotations

from typing import Any

from app.reports.forms.blocks import Block, facts, heading, number, paragraph, table
from app.reports.forms.wording import Json, words

MAX_LISTED = 5


def drift_blocks(found: Json) -> list[Block]:
    """Return the section on drift."""
    if found["drift"] is None:
        return [
            heading("Drift (7.6)"),
            paragraph("Not determined: no pose has two blocks of ten cycles."),
        ]
    rows = [
        [
            one["pose_id"],
            *(
                number(value, u)
                for value, u in zip(one["shift_mm"], one["shift_standard_uncertainty_mm"], strict=True)
            ),
            number(one["shift_distance_mm"], one["shift_distance_standard_uncertainty_mm"]),
            number(*[one["shift_distance_standard_uncertainty_mm"]] * 2),
            number(one["drp_mm"]),
            _with_uncertainty(one.get("dap_mm"), one.get("dap_standard_uncertainty_mm")),
            number(one["duration_h"]),
        ]
        for one in found["drift"]["poses"]
    ]
    columns = (
        "pose",
        "x, mm",
        "y, mm",
        "z, mm",
        "length, mm",
        "u, mm",
        "dRP_l, mm",
        "dAP_p ± u, mm",
        "over, h",
    )
    return [
        heading("Drift (7.6)"),
        *table(
            "Shift of the mean pose from the first block of cycles to the last; u: standard uncertainty of the length",
            columns,
            rows,
        ),
    ]


def _signs(found: Json) -> str:
    """Return by what cycles are not steady: by their order, or by two stopping points."""
    signs = []
    if found["common_motion"] is not None:  # looked for where their order says that something moved
        signs.append("the cycles drift, jump or depend on one another")
    if found["two_points"]:
        poses = [one["pose_id"] for one in found["two_points"]]
        more = f" and {len(poses) - MAX_LISTED} more" if len(poses) > MAX_LISTED else ""
        signs.append(f"two stopping points at {', '.join(poses[:MAX_LISTED])}{more}")
    return ", and ".join(signs)


def _with_uncertainty(value: float | None, uncertainty: float | None) -> str:
    if value is None or uncertainty is None:
        return number(value)
    return f"{number(value, uncertainty)} ± {number(uncertainty, uncertainty)}"


def steadiness_blocks(found: Json) -> list[Block]:
    """Return the section on steadiness."""
    one = found["steadiness"]
    if one["steady"] is None:
        return [heading("Steadiness"), paragraph("Not tested: no pose has six visits with a cycle number.")]
    rows: list[tuple[str, Any]] = [
        ("steady", "yes" if one["steady"] else f"no: {_signs(one)}"),
        ("tested", f"{one['cycles']} {one['counted_in']}"),
    ]
    p = one["p_values"]
    if p is not None:
        rows += [
            ("overall p", f"{number(p['overall_p_value'])} of {p['permutations']} permutations"),
            ("trend p", number(p["trend_p_value"])),
            ("change point p", number(p["change_point_p_value"])),
            ("autocorrelation p", number(p["autocorrelation_p_value"])),
        ]
    if one["effective_cycles"] is not None:
        rows.append(("effective cycles", number(one["effective_cycles"], places=1)))
    if one["common_motion"] is not None:
        rows.append(("what moved", words(one["common_motion"]["attribution"])))
    unsteady = [pose["pose_id"] for pose in one["poses"] if not pose["steady"]]
    if unsteady:
        rows.append(("poses not steady", ", ".join(unsteady)))
    for pose in one["two_points"]:
        rows.append(
            (
                f"two stopping points at {pose['pose_id']}",
                f"{number(pose['distance_mm'])} mm from one another",
            )
        )
    return [heading("Steadiness"), facts(rows)]
