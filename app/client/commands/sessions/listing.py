"""`gridpose sessions list` and `show`."""

from __future__ import annotations

from typing import Annotated

import typer

from ... import Json, ServiceClient, find_session, is_measured
from ..access import ReadAccess
from ..console import print_json, print_list

_COLUMNS = ("id", "name", "measured", "with own pose", "not measured", "waiting")


def show_list(service: ReadAccess) -> None:
    """List the sessions of a service, with how many images were measured, and how many give a pose by themselves."""
    with service.connect() as client:
        rows = []
        for session in client.items("/v1/sessions"):
            rows.append((session["id"], session["name"], *map(str, _numbers(client, session))))
        print_list(_COLUMNS, rows, "There are no sessions yet; `gridpose sessions create --help` says how.")


def _numbers(client: ServiceClient, session: Json) -> tuple[int, ...]:
    """Return how many measurements there are of each column; those without a pose of their own are looked at."""
    counts = session["counts"]
    serve = 0
    if counts["failed"]:
        failed = client.items(f"/v1/sessions/{session['id']}/measurements", status="failed")
        serve = sum(is_measured(measurement) for measurement in failed)
    measured = counts["succeeded"] + serve
    waiting = counts["queued"] + counts["running"]
    return measured, counts["succeeded"], counts["failed"] - serve, waiting


def show(
    session: Annotated[str, typer.Argument(help="Id or name of the session.")], service: ReadAccess
) -> None:
    """Print a session as the service answers it."""
    with service.connect() as client:
        print_json(find_session(client, session))
