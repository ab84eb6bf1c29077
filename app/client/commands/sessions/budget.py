"""`gridpose sessions budget`: what the uncertainty of a session's figures is made of."""

from __future__ import annotations

from typing import Annotated, Literal

import typer
from rich.markup import escape
from rich.table import Table

from ... import Json, find_session
from ..access import ReadAccess
from ..console import output_console, print_json

_COLUMNS = ("figure", "source", "type", "distribution", "u of the input", "sensitivity", "u mm", "ν", "share")
_NAMES = {
    "repeatability.rp_l_mm": "RP_l",
    "corrected.rp_l_mm": "RP_l corrected",
    "noise_floor.rp_l_mm": "noise floor",
    "accuracy.ap_p_mm": "AP_p",
    "distances.ad_mm": "AD",
}


def budget(
    session: Annotated[str, typer.Argument(help="Id or name of the session.")],
    service: ReadAccess,
    method: Annotated[
        Literal["gum", "monte_carlo"],
        typer.Option(help="gum, or monte_carlo to sample the inputs as well and compare."),
    ] = "gum",
    pose_id: Annotated[
        str | None, typer.Option(help="Of this pose alone, and of distances from or to it.")
    ] = None,
    source: Annotated[str, typer.Option(help="images, or measured_poses of another instrument.")] = "images",
    estimator: Annotated[str, typer.Option(help="How images are combined.")] = "pooled",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print both lists as the service answers them.")
    ] = False,
) -> int:
    """Show the uncertainty budget (GUM) of a session's RP_l, noise floor, AP and AD.

    Exit code 3: the session has none of these figures, or the pose is not among them.
    """
    with service.connect() as client:
        found = client.get(
            f"/v1/sessions/{find_session(client, session)['id']}/repeatability",
            method=method,
            source=source,
            estimator=estimator,
        )
    inputs, totals = (_of_pose(found[name], pose_id) for name in ("budget", "budget_totals"))
    if as_json:
        print_json({"budget": inputs, "budget_totals": totals})
    else:
        print_budget(inputs, totals)
    return 0 if totals else 3


def _of_pose(rows: list[Json], pose_id: str | None) -> list[Json]:
    return [one for one in rows if pose_id is None or pose_id in (one["pose_id"], one["to_pose_id"])]


def print_budget(inputs: list[Json], totals: list[Json]) -> None:
    """Print a table of the inputs and of the combined uncertainty of each figure."""
    console = output_console()
    if not totals:
        console.print("No figure has a budget: nothing was visited twice, or no such pose has figures.")
        return
    table = Table(title="Uncertainty budget", title_justify="left")
    for column in _COLUMNS:
        table.add_column(column, justify="left" if column in _COLUMNS[:4] else "right")
    for total in totals:
        name = _name(total)
        for one in inputs:
            if _name(one) != name:
                continue
            unit = " mm" if one["input_unit"] == "mm" else ""
            table.add_row(
                escape(name),
                one["source"],
                one["type"],
                one["distribution"],
                f"{one['input_uncertainty']:.2g}{unit}",
                f"{one['sensitivity']:.3g}",
                f"{one['standard_uncertainty_mm']:.2g}",
                _freedom(one),
                f"{one['share']:.0%}",
            )
        combined = (
            f"[bold]{escape(name)}: {_stated(total)}[/]",
            "combined",
            "",
            f"k = {total['coverage_factor']:.2f}",
            f"U = {total['expanded_uncertainty_mm']:.2g} mm",
            "",
            f"{total['standard_uncertainty_mm']:.2g}",
            _freedom(total),
            "",
        )
        table.add_row(*combined, end_section=True)
    console.print(table)
    for total in totals:
        check = total["monte_carlo"]
        if check is None:
            continue
        low, high = check["interval_mm"]
        verdict = "agrees" if check["agrees"] else "does not agree: take the interval"
        console.print(
            f"{escape(_name(total))}: {check['trials']:,} draws give {low:.4f} to {high:.4f} mm; {verdict} "
            f"({check['difference_mm']:.2g} mm off, tolerance {check['tolerance_mm']:.2g} mm)."
        )


def _stated(total: Json) -> str:
    """Return a figure with its interval, which is not symmetric; with U where it has none."""
    if total["interval_mm"] is None:
        return f"{total['value_mm']:.4f} ± {total['expanded_uncertainty_mm']:.2g} mm"
    low, high = total["interval_mm"]
    return f"{total['value_mm']:.4f} mm, 95 % interval {low:.4f} to {high:.4f} mm"


def _name(one: Json) -> str:
    way = one["pose_id"] if one["to_pose_id"] is None else f"{one['pose_id']}-{one['to_pose_id']}"
    return f"{_NAMES[one['figure']]} {way}"


def _freedom(one: Json) -> str:
    return "∞" if one["degrees_of_freedom"] is None else f"{one['degrees_of_freedom']:.3g}"
