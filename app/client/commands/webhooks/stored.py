"""`gridpose webhooks create`, `list` and `delete`."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from ..access import AdminAccess, act_on_each
from ..console import error_console, print_list


class Type(StrEnum):
    """What a webhook may be notified of."""

    session_measured = "session.measured"
    report_ready = "report.ready"
    report_failed = "report.failed"
    verdict_changed = "verdict.changed"
    robot_alarm = "robot.alarm"
    qualification_made = "qualification.made"


def create(
    name: Annotated[str, typer.Argument(help="Whom or what it is for.")],
    address: Annotated[str, typer.Argument(metavar="URL", help="The http or https address to call.")],
    service: AdminAccess,
    types: Annotated[
        list[Type] | None,
        typer.Option("--type", help="What to notify it of; repeat it for several.  [default: everything]"),
    ] = None,
) -> None:
    """Make a webhook: an address that notices are sent to; prints its secret, this once, as the last line."""
    with service.connect() as client:
        chosen = [one.value for one in types or list(Type)]
        made = client.create("/v1/webhooks", {"name": name, "url": address, "types": chosen})
        error_console().print(f"{made['id']} is made. Its secret, shown this once:")
        print(made["secret"])


def show_list(service: AdminAccess) -> None:
    """List the webhooks of a service, without their secrets."""
    with service.connect() as client:
        rows = [
            (one["id"], one["name"], one["url"], ", ".join(one["types"]), str(one["dropped"] or ""))
            for one in client.items("/v1/webhooks")
        ]
        none = "There is no webhook; `gridpose webhooks create --help` says how to make one."
        print_list(("id", "name", "url", "types", "dropped"), rows, none)


def delete(
    webhooks: Annotated[list[str], typer.Argument(help="Ids of webhooks.")], service: AdminAccess
) -> None:
    """Delete webhooks with their journals."""
    with service.connect() as client:

        def delete_one(webhook: str) -> None:
            client.delete(f"/v1/webhooks/{webhook}")
            print(f"{webhook} deleted")

        act_on_each(webhooks, delete_one, "gridpose webhooks list")
