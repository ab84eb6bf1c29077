"""`gridpose measured-poses delete`: readings of another instrument that are to go."""

from __future__ import annotations

from typing import Annotated

import typer

from ... import find_session
from ..access import AdminAccess
from ..console import OptionRefused


def delete(
    session: Annotated[str, typer.Argument(help="Id or name of the session.")],
    service: AdminAccess,
    pose: Annotated[str | None, typer.Option(help="Those of one pose alone.")] = None,
    cycle: Annotated[int | None, typer.Option(help="Those of one cycle alone.", min=1)] = None,
    everything: Annotated[bool, typer.Option("--all", help="All readings of the session.")] = False,
) -> None:
    """Delete poses that another instrument measured: those of a pose, of a cycle, of both, or all."""
    with service.connect() as client:
        if everything == (pose is not None or cycle is not None):
            raise OptionRefused(
                "Nothing is selected, or too much.", "Give --pose, --cycle or both, or else --all."
            )
        path = f"/v1/sessions/{find_session(client, session)['id']}/measured-poses"
        answer = client.delete(path, pose_id=pose, cycle=cycle)
        print(f"{answer['deleted'] if answer is not None else 0} measured poses deleted")
