"""`gridpose sessions list` and `show`."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from ... import ServiceClient, find_session
from ..access import ReadAccess
from ..console import print_list

_COLUMNS = ("id", "name", "succeeded", "failed", "waiting")


def show_list(service: ReadAccess) -> int:
    """List the sessions of a service, with the numbers of their measurements."""

    def act(client: ServiceClient) -> None:
        rows = []
        for session in client.items("/v1/sessions"):
            counts = session["counts"]
            numbers = (counts["succeeded"], counts["failed"], counts["queued"] + counts["running"])
            rows.append((session["id"], session["name"], *map(str, numbers)))
        print_list(_COLUMNS, rows, "There are no sessions yet; `gridpose sessions create --help` says how.")

    return service.run(act)


def show(
    session: Annotated[str, typer.Argument(help="Id or name of the session.")], service: ReadAccess
) -> int:
    """Print a session as the service answers it."""

    def act(client: ServiceClient) -> None:
        print(json.dumps(find_session(client, session), indent=2, allow_nan=False))

    return service.run(act)
