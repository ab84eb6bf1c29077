"""The demo's second session in words and tables: Table IV, what the figures are worth, and what cannot be told."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from app.agent import Json
from app.cli.demo_arm import GRID, LENS_MM, SIZE_PX, ArmAnswers
from app.cli.demo_arm_tables import METHODS, accuracy_table, parameter_table
from app.cli.demo_arm_truth import (
    accuracy,
    arm_faults,
    nominal_accuracy,
    parameters_beside_truth,
    poses_used,
    true_scatter_mm,
)
from core.simulation.arm_session import ArmSession

AS_PRINTED = (
    "true: the arm as built, in the same conventions. The paper prints links 1 to 5 without signs, truth or "
    "uncertainty, and does not state the conventions of its joint offsets (here d)."
)


def introduce_arm(console: Console, session: ArmSession) -> None:
    """Say what is to be simulated."""
    free = sum("free" in pose.pose_id for pose in session.poses)
    console.print(
        f"[bold]The same arm[/], off its data sheet by tenths of a millimetre and hundredths of a degree, then carries "
        f"a lens of {LENS_MM:g} mm. It sweeps joint after joint as far as it sees one of two mutually perpendicular "
        f"{GRID.columns} × {GRID.rows} chessboards, and looks at them from {free} free poses: {len(session.images)} "
        f"images of {SIZE_PX[0]} × {SIZE_PX[1]} pixels.\n"
    )


def show_arm(console: Console, session: ArmSession, answers: ArmAnswers, folder: Path) -> bool:
    """Print and keep what was identified; return whether it came out as it must."""
    found = {
        method: parameters_beside_truth(session.arm, answer) for method, answer in answers.by_method.items()
    }
    by_method = {method: accuracy(found[method], answer) for method, answer in answers.by_method.items()}
    parameters, answer = found["global"], answers.by_method["global"]
    _keep(folder, answers, {method: [asdict(p) for p in rows] for method, rows in found.items()})
    console.print()
    console.print(parameter_table(parameters))
    console.print(AS_PRINTED, style="dim")
    console.print()
    console.print(accuracy_table(nominal_accuracy(parameters), by_method, answers.by_method))
    for method, refusal in answers.refusals.items():
        console.print(f"  {METHODS[method]}: {escape(refusal.detail)} ({refusal.code})", style="dim")
    console.print()
    _say_how_well(console, session, answer)
    console.print("What no pose can tell stays as in the data sheet:")
    for sentence in answer["null_space"]:
        console.print(f"  {escape(sentence)}", style="dim")
    console.print()
    own = by_method["global"]
    console.print(
        f"[bold]{poses_used(answer)} poses tell {sum(p.uncertainty is not None for p in parameters)} parameters of "
        f"the arm.[/] The true error is {own.ratio:.2f} times the stated uncertainty, correlations respected."
    )
    faults = arm_faults(session, answers, parameters)
    for fault in faults:
        console.print(f"[red]This is not as it must be: {escape(fault)}.[/]")
    return not faults


def _say_how_well(console: Console, session: ArmSession, answer: Json) -> None:
    held = answer["validation"]
    if held is not None and held["nominal"] is not None:
        console.print(
            f"Held out in turn and predicted by the others, {held['held_out']} camera poses are met to "
            f"{held['position_rms_mm']:.2f} mm and {held['rotation_rms_deg']:.3f}° (the images' noise is in it); by "
            f"the data sheet to {held['nominal']['position_rms_mm']:.2f} mm and "
            f"{held['nominal']['rotation_rms_deg']:.3f}°."
        )
    console.print(
        f"The robot's own scatter is put at {answer['robot_scatter']['position_mm']:.3f} mm a coordinate; its joints, "
        f"which come back to 33 µrad, make {true_scatter_mm(session):.3f} mm."
    )


def _keep(folder: Path, answers: ArmAnswers, truth: Json) -> None:
    """Write the answers as the service gave them, and every parameter with its truth."""
    for name, document in (("dh.json", dict(answers.by_method)), ("dh-truth.json", truth)):
        (folder / name).write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
