"""`gridpose robots history`: a robot's figures over its sessions, with control charts of those that are comparable."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from app.cli.options.access import ReadAccess
from app.client import Json, find_robot
from app.client.commands import OptionRefused, error_console, output_console, print_list, write_file

_COLUMNS = ("of", "figure", "sessions", "first", "last", "three-sigma limits", "outside")


def history(
    robot: Annotated[str, typer.Argument(help="Id or name of the robot.")],
    service: ReadAccess,
    table: Annotated[
        Path | None,
        typer.Option("--csv", help="Write every figure of every session to this file.", dir_okay=False),
    ] = None,
    drawing: Annotated[
        Path | None, typer.Option("--svg", help="Draw the control charts to this file.", dir_okay=False)
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option(help="repeatability, kinematics, camera or qualification alone.  [default: all]"),
    ] = None,
) -> int:
    """Show RP, AP, noise floor, parameters and cameras of a robot over its reports, and what changed lastingly.

    Each session counts by its latest report of a kind. Only sessions of the same commanded poses, load, speed and
    temperature (within 2 K) share a control chart. Ends with 1 where a chart shows a lasting change.
    """
    with service.connect() as client:
        path = f"/v1/robots/{find_robot(client, robot)['id']}/history"
        found = client.get(path, kind=kind)
        for warning in found["warnings"]:
            error_console().print(escape(f"{warning['detail']} {warning['advice'] or ''}"), style="yellow")
        if not found["tests"]:
            raise OptionRefused(
                "There is no report of a session of this robot.",
                "Make one of each session: `gridpose report create SESSION --kind repeatability`.",
            )
        for test in found["tests"]:
            _print_test(found, test)
        alarms = [one["alarm"]["sentence"] for one in found["series"] if one["alarm"] is not None]
        for sentence in alarms:
            output_console().print(escape(sentence))
        if table is not None:
            write_file(table, client.get_bytes(path, accept="text/csv", kind=kind))
        if drawing is not None:
            write_file(drawing, client.get_bytes(f"{path}.svg", kind=kind))
    return int(bool(alarms))


def _print_test(found: Json, test: Json) -> None:
    number = test["test"]
    sessions = "session" if test["sessions"] == 1 else "sessions"
    print(
        f"Test {number}: {test['test_kind']}, {test['sessions']} comparable {sessions}, "
        f"from {test['first_measured_at']}"
    )
    names: dict[tuple[str, str], list[str]] = {}
    for point in found["session_figures"]:
        if point["test"] == number and point["outside"]:
            names.setdefault((point["of"], point["figure"]), []).append(point["session_name"])
    rows = []
    for one in found["series"]:
        if one["test"] != number:
            continue
        limits = one["limits"]
        rows.append(
            (
                *(one["of"], one["figure"], str(one["sessions"])),
                *(f"{one[which]:.6g} {one['unit']}" for which in ("first", "last")),
                "" if limits is None else f"{limits['low']:.4g} to {limits['high']:.4g}",
                ", ".join(names.get((one["of"], one["figure"]), [])),
            )
        )
    print_list(_COLUMNS, rows, "No figures.")
    if not test["charted"]:
        error_console().print(
            f"[yellow]No chart: {test['sessions']} sessions are comparable, and a chart takes five.[/]"
        )
