"""`gridpose robots plan dh`: predicted uncertainty of a robot's DH parameters for a set of poses."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app.cli.options.access import UploadAccess
from app.client import Json, find_robot
from app.client.commands import print_json, read_mapping

_COLUMNS = (
    ("a_mm", "u(a) mm"),
    ("alpha_deg", "u(α) °"),
    ("d_mm", "u(d) mm"),
    ("theta_offset_deg", "u(θ) °"),
    ("beta_deg", "u(β) °"),
)


def plan_dh(
    file: Annotated[
        Path,
        typer.Argument(
            help="YAML or JSON with target_id, camera, home_deg, sweeps, ... as POST .../dh-plan takes them.",
            exists=True,
            dir_okay=False,
        ),
    ],
    robot: Annotated[str, typer.Option(help="Id or name of the robot.")],
    service: UploadAccess,
    as_json: Annotated[bool, typer.Option("--json", help="Print the service's answer unchanged.")] = False,
) -> None:
    """Predict the uncertainty of every DH parameter for a set of poses, and suggest the poses that help most."""
    with service.connect() as client:
        body = read_mapping(file)
        plan = client.create(f"/v1/robots/{find_robot(client, robot)['id']}/dh-plan", body)
        if as_json:
            print_json(plan)
        else:
            _show(Console(highlight=False, emoji=False), plan)


def _show(console: Console, plan: Json) -> None:
    visible = sum(pose["shows_target"] for pose in plan["poses"])
    console.print(f"{visible} of {len(plan['poses'])} poses show the whole grid")
    console.print(_table("Predicted standard uncertainties for these poses", plan["joints"]))
    condition = plan["condition_number"]
    shown = "none" if condition is None else f"{condition:.0f}"
    console.print(f"condition number {shown}, observability {_indices(plan['observability_indices'])}")
    for group in plan["null_space"]:
        console.print(escape(group["sentence"]))
    if plan["suggested_poses"]:
        console.print(
            f"{len(plan['suggested_poses'])} further poses that reduce the uncertainty most, best first (degrees):"
        )
        for pose in plan["suggested_poses"]:
            console.print("  " + ", ".join(f"{angle:.2f}" for angle in pose["joint_angles_deg"]))
        if plan["predicted_joints_with_suggestions"] is not None:
            console.print(
                _table("Predicted with the suggested poses", plan["predicted_joints_with_suggestions"])
            )
            console.print(f"observability {_indices(plan['observability_indices_with_suggestions'])}")


def _indices(indices: Json) -> str:
    return ", ".join(f"{name.upper()} {value:.3g}" for name, value in indices.items())


def _table(title: str, joints: list[Json]) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("joint", justify="right")
    for _, header in _COLUMNS:
        table.add_column(header, justify="right")
    for joint in joints:
        uncertainty = joint["standard_uncertainty"]
        cells = ["-" if uncertainty[name] is None else f"{uncertainty[name]:.2g}" for name, _ in _COLUMNS]
        table.add_row(str(joint["joint"]), *cells)
    return table
