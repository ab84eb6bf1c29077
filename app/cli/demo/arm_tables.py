"""The demo's second session in tables and words: Table IV with its truth, what it is worth, what is not observable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app.cli.demo.arm_evaluation import (
    Accuracy,
    Parameter,
    accuracy,
    failed_arm_checks,
    nominal_accuracy,
    parameters_with_truth,
    poses_used,
    true_scatter_mm,
)
from app.cli.demo.arm_session import GRID, LENS_MM, SIZE_PX, ArmAnswers
from app.cli.demo.command import keep
from app.cli.demo.evaluation import root_mean_square
from app.cli.demo.paper_figures import PRINTED_LINKS
from app.cli.demo.tables import plain_table
from app.client import Json
from core.simulation import KR5_ARC, ArmSession

METHODS = {
    "cpa": "cpa: circles, as the paper",
    "combined": "combined: axes by encoders",
    "global": "global (Gridpose)",
}
AS_PRINTED = (
    "true: the arm as built, in the same conventions. The paper prints links 1 to 5 without signs, truth or "
    "uncertainty, and does not state the conventions of its joint offsets (here d)."
)


def print_arm_introduction(console: Console, session: ArmSession) -> None:
    """Say what is to be simulated."""
    free = sum("free" in pose.pose_id for pose in session.poses)
    console.print(
        f"[bold]The same arm[/], off its data sheet by tenths of a millimetre and hundredths of a degree, then carries "
        f"a lens of {LENS_MM:g} mm. It sweeps joint after joint as far as it sees one of two mutually perpendicular "
        f"{GRID.columns} × {GRID.rows} chessboards, and looks at them from {free} free poses: {len(session.images)} "
        f"images of {SIZE_PX[0]} × {SIZE_PX[1]} pixels.\n"
    )


def report_arm(console: Console, session: ArmSession, answers: ArmAnswers, folder: Path) -> bool:
    """Print and keep what was identified; return whether it came out as it must."""
    found = {
        method: parameters_with_truth(session.arm, answer) for method, answer in answers.by_method.items()
    }
    by_method = {method: accuracy(found[method], answer) for method, answer in answers.by_method.items()}
    parameters, answer = found["global"], answers.by_method["global"]
    truth = {method: [asdict(p) for p in rows] for method, rows in found.items()}
    keep(folder, {"dh.json": dict(answers.by_method), "dh-truth.json": truth})
    console.print()
    console.print(parameter_table(parameters))
    console.print(AS_PRINTED, style="dim")
    console.print()
    console.print(accuracy_table(nominal_accuracy(parameters), by_method, answers.by_method))
    for method, refusal in answers.refusals.items():
        console.print(f"  {METHODS[method]}: {escape(refusal.detail)} ({refusal.code})", style="dim")
    console.print()
    _say_how_well(console, session, answer)
    console.print("What no pose determines stays as in the data sheet:")
    for group in answer["null_space"]:
        console.print(f"  {escape(group['sentence'])}", style="dim")
    console.print()
    own = by_method["global"]
    console.print(
        f"[bold]{poses_used(answer)} poses determine {sum(p.uncertainty is not None for p in parameters)} parameters "
        f"of the arm.[/] The true error is {own.ratio:.2f} times the stated uncertainty, correlations respected."
    )
    failed_checks = failed_arm_checks(session, answers, parameters)
    for failed_check in failed_checks:
        console.print(f"[red]This is not as it must be: {escape(failed_check)}.[/]")
    return not failed_checks


def _say_how_well(console: Console, session: ArmSession, answer: Json) -> None:
    held = answer["validation"]
    if held is not None and held["nominal"] is not None:
        console.print(
            f"Held out in turn and predicted by the others, {held['held_out_poses']} camera poses are met to "
            f"{held['position_rms_mm']:.2f} mm and {held['rotation_rms_deg']:.3f}° (the images' noise is in it); by "
            f"the data sheet to {held['nominal']['position_rms_mm']:.2f} mm and "
            f"{held['nominal']['rotation_rms_deg']:.3f}°."
        )
    console.print(
        f"The robot's own scatter is put at {answer['robot_scatter']['position_sigma_mm']:.3f} mm a coordinate; its "
        f"joints, which come back to 33 µrad, make {true_scatter_mm(session):.3f} mm."
    )


def parameter_table(parameters: Sequence[Parameter]) -> Table:
    """Return every DH parameter with its truth; those that no pose determines as the data sheet states them."""
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
