"""`gridpose robots events`: what was done to a robot."""

from __future__ import annotations

import csv
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from ... import find_robot
from ..access import AdminAccess, ReadAccess, UploadAccess, act_on_each
from ..console import OptionRefused, print_list

_YES = {"yes": True, "no": False, "": False}
Robot = Annotated[str, typer.Argument(help="Id or name of the robot.")]


def add(
    robot: Robot,
    service: UploadAccess,
    note: Annotated[str | None, typer.Argument(help="What was done, in one line.")] = None,
    at: Annotated[
        str | None,
        typer.Option(help="When: 2026-05-31, or 2026-05-31T14:00:00Z.  [default: now]"),
    ] = None,
    restarts_charts: Annotated[
        bool,
        typer.Option("--restarts-charts", help="Figures before and after it are not to be compared."),
    ] = False,
    file: Annotated[
        Path | None,
        typer.Option(
            "--from",
            help="Events of a CSV file with the columns at, note, restarts (yes where charts begin anew).",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
) -> None:
    """Note something done to a robot: its history shows it, charts mark it, and alarms name what came before them."""
    with service.connect() as client:
        events = _given(note, at, file, restarts_charts=restarts_charts)
        robot_id = find_robot(client, robot)["id"]
        for event in events:
            print(client.create(f"/v1/robots/{robot_id}/events", event)["id"])


def show_list(robot: Robot, service: ReadAccess) -> None:
    """List what was done to a robot, oldest first."""
    with service.connect() as client:
        robot_id = find_robot(client, robot)["id"]
        events = sorted(client.items(f"/v1/robots/{robot_id}/events"), key=lambda event: event["at"])
        rows = [
            (e["id"], e["at"], "yes" if e["restarts_charts"] else "", e["made_by_name"] or "", e["note"])
            for e in events
        ]
        none = "Nothing is noted of this robot; `gridpose robots events add --help` says how."
        print_list(("id", "at", "restarts charts", "by", "note"), rows, none)


def delete(
    robot: Robot,
    events: Annotated[list[str], typer.Argument(help="Ids of events.")],
    service: AdminAccess,
) -> None:
    """Delete events that were noted in error."""
    with service.connect() as client:
        robot_id = find_robot(client, robot)["id"]

        def delete_one(event: str) -> None:
            client.delete(f"/v1/robots/{robot_id}/events/{event}")
            print(f"{event} deleted")

        act_on_each(events, delete_one, "gridpose robots events list ROBOT")


def _given(
    note: str | None, at: str | None, file: Path | None, *, restarts_charts: bool
) -> list[dict[str, Any]]:
    """Return the events that the options give. Raises OptionRefused."""
    if (note is None) == (file is None):
        raise OptionRefused("Give a note, or --from with a file.", "`gridpose robots events add --help`.")
    if file is None:
        moment = datetime.now(UTC) if at is None else _time(at)
        return [{"at": _text(moment), "note": note, "restarts_charts": restarts_charts}]
    if at is not None or restarts_charts:
        raise OptionRefused(
            "--at and --restarts-charts are of a single note.", "The file's columns have both."
        )
    return _read(file)


def _read(path: Path) -> list[dict[str, Any]]:
    """Return the events of a CSV file. Raises OptionRefused."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return [
                {
                    "at": _text(datetime.fromisoformat(row["at"].strip())),
                    "note": row["note"].strip(),
                    "restarts_charts": _YES[(row.get("restarts") or "").strip().lower()],
                }
                for row in csv.DictReader(file)
            ]
    except (OSError, KeyError, ValueError, TypeError, AttributeError, csv.Error) as error:
        raise OptionRefused(
            f"{path} is no list of events.",
            "Its columns are at (2026-05-31 or 2026-05-31T14:00:00Z), note, and restarts (yes or no).",
        ) from error


def _time(text: str) -> datetime:
    try:
        return datetime.fromisoformat(text.strip())
    except ValueError:
        raise OptionRefused(
            f"--at {text} is no time.", "Write it as 2026-05-31 or 2026-05-31T14:00:00Z."
        ) from None


def _text(moment: datetime) -> str:
    """Return a time as the service takes it; one without a zone is in UTC."""
    moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    return moment.isoformat(timespec="seconds").replace("+00:00", "Z")
