"""`gridpose targets list`, `show` and `delete`: the targets of a service."""

from __future__ import annotations

from typing import Annotated

import typer

from ... import find_target
from ..access import AdminAccess, ReadAccess, act_on_each
from ..console import print_json, print_list

_COLUMNS = ("id", "name", "kind", "columns x rows", "pitch, mm")


def show_list(service: ReadAccess) -> None:
    """List the targets of a service."""
    with service.connect() as client:
        rows = [
            (t["id"], t["name"], t["kind"], f"{t['columns']} x {t['rows']}", f"{t['pitch_mm']:g}")
            for t in client.items("/v1/targets")
        ]
        print_list(_COLUMNS, rows, "There are no targets yet; `gridpose targets create --help` says how.")


def show(
    target: Annotated[
        str, typer.Argument(help="Id or name of the target, or sheet: and the id on its print.")
    ],
    service: ReadAccess,
) -> None:
    """Print a target as the service answers it."""
    with service.connect() as client:
        print_json(find_target(client, target))


def delete(
    targets: Annotated[
        list[str], typer.Argument(help="Ids or names of targets, or sheet: and the id on a print.")
    ],
    service: AdminAccess,
) -> None:
    """Delete targets that no session and no measurement refers to."""
    with service.connect() as client:

        def delete_one(target: str) -> None:
            target_id = find_target(client, target)["id"]
            client.delete(f"/v1/targets/{target_id}")
            print(f"{target_id} deleted")

        act_on_each(targets, delete_one, "gridpose targets list")
