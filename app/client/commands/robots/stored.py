"""`gridpose robots list`, `show` and `delete`: the robots of a service."""

from __future__ import annotations

from typing import Annotated

import typer

from ... import find_robot
from ..access import AdminAccess, ReadAccess, act_on_each
from ..console import print_json, print_list
from .known import KNOWN


def show_list(
    service: ReadAccess,
    known: Annotated[
        bool,
        typer.Option("--known", help="List the models whose parameters `--known` of `robots create` knows."),
    ] = False,
) -> None:
    """List the robots of a service."""
    if known:
        models = [(robot.model, robot.maker, robot.source) for robot in KNOWN]
        print_list(("model", "maker", "source"), models, "")
        return

    with service.connect() as client:
        rows = [(r["id"], r["name"], str(len(r["joints"]))) for r in client.items("/v1/robots")]
        none = "There are no robots yet; `gridpose robots create --help` says how."
        print_list(("id", "name", "joints"), rows, none)


def show(robot: Annotated[str, typer.Argument(help="Id or name of the robot.")], service: ReadAccess) -> None:
    """Print a robot as the service answers it."""
    with service.connect() as client:
        print_json(find_robot(client, robot))


def delete(
    robots: Annotated[list[str], typer.Argument(help="Ids or names of robots.")],
    service: AdminAccess,
) -> None:
    """Delete robots that no session names."""
    with service.connect() as client:

        def delete_one(robot: str) -> None:
            robot_id = find_robot(client, robot)["id"]
            client.delete(f"/v1/robots/{robot_id}")
            print(f"{robot_id} deleted")

        act_on_each(robots, delete_one, "gridpose robots list")
