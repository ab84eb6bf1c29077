"""`gridpose plan dh`: what a set of poses would tell of a robot, before anyone moves it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import stamina
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app.agent import ClientError, Json, ServiceClient

_COLUMNS = (
    ("a_mm", "u(a) mm"),
    ("alpha_deg", "u(α) °"),
    ("d_mm", "u(d) mm"),
    ("theta_offset_deg", "u(θ) °"),
    ("beta_deg", "u(β) °"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """The options of `gridpose plan dh`."""

    file: Path
    robot: str
    url: str
    key: str | None
    as_json: bool
    retry_for_s: float


def plan_dh(request: Request) -> int:
    """Ask the service, show the answer, and return the exit code."""
    console = Console(highlight=False)
    errors = Console(stderr=True, highlight=False, soft_wrap=True)
    stamina.instrumentation.set_on_retry_hooks([])
    try:
        body = _read(request.file)
    except ValueError as error:
        errors.print(f"[red]{escape(str(error))}[/]")
        return 2
    try:
        with ServiceClient(
            request.url,
            request.key,
            retry_for_s=request.retry_for_s,
            on_retry=lambda reason: errors.print(f"[yellow]trying again: {escape(reason)}[/]"),
        ) as client:
            robot_id = _robot(client, request.robot)
            plan = client.create(f"/v1/robots/{robot_id}/dh-plan", body)
    except ClientError as error:
        errors.print(f"[red]{escape(str(error))}[/]")
        if error.advice:
            errors.print(escape(error.advice))
        return 1
    if request.as_json:
        print(json.dumps(plan, indent=2, allow_nan=False))
    else:
        _show(console, plan)
    return 0


def _read(file: Path) -> Json:
    import yaml

    try:
        body = yaml.safe_load(file.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{file} cannot be read: {error}.") from error
    except RecursionError as error:
        raise ValueError(f"{file} is nested too deep to be a plan.") from error
    except yaml.YAMLError as error:
        raise ValueError(f"{file} is no YAML or JSON: {error}") from error
    if not isinstance(body, dict):
        raise ValueError(f"{file} does not hold a plan: target_id, camera, home_deg, sweeps, ...")
    return body


def _robot(client: ServiceClient, robot: str) -> str:
    """Return the id of the robot with this id or name."""
    named = []
    for entry in client.items("/v1/robots"):
        if entry["id"] == robot:
            return robot
        if entry["name"] == robot:
            named.append(str(entry["id"]))
    if len(named) != 1:
        problem = "No robot has" if not named else "Several robots have"
        raise ClientError(
            "robot_not_found" if not named else "robot_ambiguous",
            f"{problem} the id or the name {robot!r}.",
            "Give the id; GET /v1/robots lists them.",
        )
    return named[0]


def _show(console: Console, plan: Json) -> None:
    seen = sum(pose["visible"] for pose in plan["poses"])
    console.print(f"{seen} of {len(plan['poses'])} poses see their whole grid")
    console.print(_table("Standard uncertainties that these poses would give", plan["joints"]))
    condition = plan["condition_number"]
    told = "none" if condition is None else f"{condition:.0f}"
    console.print(f"condition number {told}, observability index O1 {plan['observability_o1']:.3g}")
    for sentence in plan["null_space"]:
        console.print(escape(sentence))
    if plan["suggested"]:
        console.print(f"{len(plan['suggested'])} further poses that would tell most, best first (degrees):")
        for angles in plan["suggested"]:
            console.print("  " + ", ".join(f"{angle:.2f}" for angle in angles))
        if plan["joints_with_suggested"] is not None:
            console.print(_table("With them", plan["joints_with_suggested"]))


def _table(title: str, joints: list[Json]) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("joint", justify="right")
    for _, header in _COLUMNS:
        table.add_column(header, justify="right")
    for joint in joints:
        doubt = joint["standard_uncertainty"]
        cells = ["-" if doubt[name] is None else f"{doubt[name]:.2g}" for name, _ in _COLUMNS]
        table.add_row(str(joint["joint"]), *cells)
    return table
