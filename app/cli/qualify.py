"""`gridpose qualify`: known lengths against what a session measured of them, and a record of it."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from app.cli.client_options import UploadAccess
from app.cli.console import OptionRefused, output_console
from app.cli.record_files import read_records
from app.client import Json, ServiceClient, find_session

_POSES = ("from_pose_id", "to_pose_id")
_NUMBERS = ("length_mm", "standard_uncertainty_mm")


def qualify(
    session: Annotated[str, typer.Argument(help="Id or name of the session that visited the poses.")],
    lengths: Annotated[
        Path,
        typer.Argument(
            help="CSV, JSON or YAML with from_pose_id, to_pose_id, length_mm, standard_uncertainty_mm.",
            exists=True,
            dir_okay=False,
        ),
    ],
    service: UploadAccess,
    maximum_error_mm: Annotated[
        float | None, typer.Option(help="Limit on every length's error, to be decided on.", min=0.0)
    ] = None,
    source: Annotated[str, typer.Option(help="images, or measured_poses of another instrument.")] = "images",
    valid_days: Annotated[
        int, typer.Option(help="When the next qualification is due, for the record.", min=1, max=36500)
    ] = 365,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Record to write, .json; an existing one is kept.")
    ] = None,
) -> int:
    """Compare known lengths between poses of a session with what it measured of them.

    Lengths come from a stage, from gauge blocks, or from the robot measured by a standard. Exit code 3: a length is
    beyond the limit, or the limit cannot be decided on.
    """

    decisions: list[str | None] = []

    def act(client: ServiceClient) -> None:
        body = {"lengths": _read(lengths), "maximum_permissible_error_mm": maximum_error_mm, "source": source}
        session_id = find_session(client, session)["id"]
        found = client.create(f"/v1/sessions/{session_id}/qualification", body)
        if output is not None:
            _write(output, found, valid_days)
        _show(found)
        decisions.append(found["decision"])

    code = service.run(act)
    return 3 if decisions and decisions[0] in ("fail", "inconclusive") else code


def _read(path: Path) -> list[dict[str, Any]]:
    found = []
    for record in read_records(path, None, None).entries:
        missing = [name for name in (*_POSES, *_NUMBERS) if record.fields.get(name) in (None, "")]
        if missing:
            raise OptionRefused(
                f"{path.name}, {record.place}: {', '.join(missing)} missing.",
                "Give from_pose_id, to_pose_id, length_mm and standard_uncertainty_mm of every length.",
            )
        try:
            numbers = {name: float(record.fields[name]) for name in _NUMBERS}
        except (TypeError, ValueError):
            raise OptionRefused(f"{path.name}, {record.place}: a length is not a number.") from None
        found.append({name: str(record.fields[name]) for name in _POSES} | numbers)
    return found


def _write(path: Path, found: Json, valid_days: int) -> None:
    made = datetime.now(UTC).replace(microsecond=0)
    record = {
        "made_at": made.isoformat(),
        "due_at": (made + timedelta(days=valid_days)).isoformat(),
        **found,
    }
    try:
        with path.open("x", encoding="utf-8") as file:
            json.dump(record, file, indent=2, allow_nan=False)
            file.write("\n")
    except FileExistsError:
        raise OptionRefused(f"{path} exists.", "A record is not replaced; give another name.") from None
    except OSError as error:
        raise OptionRefused(f"{path} cannot be written: {error.strerror}.") from error


def _show(found: Json) -> None:
    console = output_console()
    table = Table(title="Length errors, mm", title_justify="left")
    for column in ("from", "to", "calibrated", "measured", "error", "95 % interval"):
        table.add_column(column)
    for one in found["lengths"]:
        low, high = one["interval_mm"]
        table.add_row(
            escape(one["from_pose_id"]),
            escape(one["to_pose_id"]),
            f"{one['length_mm']:.4f}",
            f"{one['measured_mm']:.4f}",
            f"{one['error_mm']:+.4f}",
            f"{low:+.4f} to {high:+.4f}",
        )
    console.print(table)
    scale, u = found["scale_ppm"], found["scale_standard_uncertainty_ppm"]
    console.print(f"Lengths are measured {scale:+.0f} ppm too long, standard uncertainty {u:.0f} ppm.")
    if found["probing_scatter_mm"] is not None:
        console.print(
            f"Largest distance of a visit from its pose's mean: {found['probing_scatter_mm']:.4f} mm."
        )
    if found["decision"] is not None:
        limit = found["maximum_permissible_error_mm"]
        console.print(f"Limit of {limit:g} mm: {found['decision']}.")
