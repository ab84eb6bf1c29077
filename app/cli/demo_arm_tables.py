"""The paper's Table IV with its truth, in 80 columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from rich.table import Table

from app.agent import Json
from app.cli.demo_arm_truth import Accuracy, Parameter
from app.cli.demo_paper import PRINTED_LINKS
from app.cli.demo_tables import plain_table
from app.cli.demo_truth import root_mean_square
from core.simulation.arm import KR5_ARC

METHODS = {
    "cpa": "cpa: circles, as the paper",
    "combined": "combined: axes by encoders",
    "global": "global (Gridpose)",
}


def parameter_table(parameters: Sequence[Parameter]) -> Table:
    """Return every DH parameter beside its truth; those that no pose can tell as the data sheet has them."""
    table = plain_table(
        "Table IV: the robot's DH parameters, mm and ° (method global)",
        *("joint", "", "data sheet", "true", "identified", "± u", "err/u", "the paper"),
        left=("",),
    )
    joint = None
    for p in parameters:
        first = str(p.joint) if p.joint != joint else ""
        joint = p.joint
        name, nominal, printed = p.name, f"{p.nominal:.3f}", printed_value(p.joint, p.name)
        if p.uncertainty is None:
            table.add_row(first, name, nominal, "-", "as sheet", "-", "-", printed)
            continue
        digits = 5 if p.is_angle else 4
        table.add_row(
            first,
            name,
            nominal,
            f"{p.true:.{digits}f}",
            f"{p.identified:.{digits}f}",
            f"{p.uncertainty:.{digits}f}",
            f"{abs(p.error) / p.uncertainty:.2f}",
            printed,
        )
    return table


def printed_value(joint: int, name: str) -> str:
    """Return what the paper printed for a parameter, or a dash."""
    values = PRINTED_LINKS.get(name, ())
    return f"{values[joint - 1]:.1f}" if joint <= len(values) else "-"


def accuracy_table(sheet: Accuracy, by_method: Mapping[str, Accuracy], answers: Mapping[str, Json]) -> Table:
    """Return how far each method's robot is from the truth, and from poses that it did not see."""
    table = plain_table(
        "Table IV by method: rms errors against the truth, and at held-out poses",
        *("", "mm", "°", "err/u", "held out mm", "°"),
    )
    held = answers["global"]["validation"]
    table.add_row("the data sheet", *_errors(sheet), *_held_out(held and held["nominal"]))
    for method, name in METHODS.items():
        if method in by_method:
            validation = answers[method]["validation"]
            table.add_row(name, *_errors(by_method[method]), *_held_out(validation))
        else:
            table.add_row(name, *(["-"] * 5))
    a, alpha = printed_from_sheet()
    table.add_row("[italic]the paper, off the data sheet[/]", f"{a:.1f}", f"{alpha:.2f}", "-", "-", "-")
    return table


def printed_from_sheet() -> tuple[float, float]:
    """Return how far the paper's a (mm) and alpha (°) are from the data sheet, rms; it prints alpha without sign."""
    nominal = KR5_ARC.as_array()[:5]
    a = np.array(PRINTED_LINKS["a"]) - nominal[:, 0]
    alpha = np.array(PRINTED_LINKS["alpha"]) - np.abs(np.degrees(nominal[:, 1]))
    return root_mean_square(a.tolist()), root_mean_square(alpha.tolist())


def _errors(found: Accuracy) -> tuple[str, str, str]:
    ratio = "-" if found.ratio is None else f"{found.ratio:.2f}"
    return f"{found.lengths_mm:.4f}", f"{found.angles_deg:.5f}", ratio


def _held_out(errors: Json | None) -> tuple[str, str]:
    if errors is None:
        return "-", "-"
    return f"{errors['position_rms_mm']:.3f}", f"{errors['rotation_rms_deg']:.4f}"
