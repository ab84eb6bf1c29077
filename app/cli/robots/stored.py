"""`gridpose robots list` and `delete`: the robots of a service."""

from __future__ import annotations

from typing import Annotated

import typer

from app.cli.client_options import AdminAccess, ReadAccess
from app.cli.console import print_list
from app.client import ServiceClient, find_robot


def show_list(service: ReadAccess) -> int:
    """List the robots of a service."""

    def act(client: ServiceClient) -> None:
        rows = [(r["id"], r["name"], str(len(r["joints"]))) for r in client.items("/v1/robots")]
        none = "There are no robots yet; `gridpose robots create --help` says how."
        print_list(("id", "name", "joints"), rows, none)

    return service.run(act)


def delete(
    robots: Annotated[list[str], typer.Argument(help="Ids or names of robots.")],
    service: AdminAccess,
) -> int:
    """Delete robots that no session names."""

    def act(client: ServiceClient) -> None:
        for robot in robots:
            robot_id = find_robot(client, robot)["id"]
            client.delete(f"/v1/robots/{robot_id}")
            print(f"{robot_id} deleted")

    return service.run(act)
