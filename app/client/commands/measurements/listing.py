"""`gridpose measurements list` and `show`."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from ... import Json, find_session
from ...summary import outcome_in_words
from ..access import ReadAccess
from ..console import print_json, print_list

_COLUMNS = ("id", "pose", "cycle", "what came of it", "reason", "file", "target")


def show_list(
    session: Annotated[str, typer.Argument(help="Id or name of the session.")],
    service: ReadAccess,
    status: Annotated[
        Literal["queued", "running", "succeeded", "failed"] | None,
        typer.Option(
            help="Those of one status of the API alone: succeeded with a pose of their own, failed without one."
        ),
    ] = None,
    pose: Annotated[str | None, typer.Option(help="Those of one pose alone.")] = None,
) -> None:
    """List a session's measurements with their ids, why they failed, and why they are excluded."""
    with service.connect() as client:
        path = f"/v1/sessions/{find_session(client, session)['id']}/measurements"
        found = client.items(path, status=status, pose_id=pose)
        print_list(_COLUMNS, map(_cells, found), "No measurement matches; `gridpose upload` sends images.")


def show(
    measurement: Annotated[str, typer.Argument(help="Id of the measurement.")],
    service: ReadAccess,
) -> None:
    """Print a measurement as the service answers it."""
    with service.connect() as client:
        print_json(client.get(f"/v1/measurements/{measurement}"))


def _cells(measurement: Json) -> tuple[str, ...]:
    reason = measurement["failure"]["code"] if measurement["failure"] is not None else ""
    if measurement["excluded"] is not None:
        reason = f"excluded: {measurement['excluded']['reason']}"
    cycle = measurement["cycle"]
    return (
        measurement["id"],
        measurement["pose_id"],
        ""
        if cycle is None
        else f"{cycle}"
        if (measurement["burst"] or 1) == 1
        else f"{cycle}, {measurement['burst']}",
        outcome_in_words(measurement),
        reason,
        measurement["filename"] or "",
        measurement["target_id"] or "",
    )
