"""`gridpose sessions next-view`: where to take the next images of a target."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from ... import Json, ServiceClient, find_session
from ..access import UploadAccess
from ..console import output_console


def next_view(
    session: Annotated[str, typer.Argument(help="Id or name of the session.")],
    service: UploadAccess,
    count: Annotated[int, typer.Option(min=1, max=50, help="Views to suggest.")] = 3,
    as_json: Annotated[bool, typer.Option("--json", help="Print the service's answer unchanged.")] = False,
) -> int:
    """Suggest the views that would make a session's camera most certain."""

    def act(client: ServiceClient) -> None:
        address = f"/v1/sessions/{find_session(client, session)['id']}/next-view"
        found = client.create(address, {"purpose": "intrinsics", "count": count})
        if as_json:
            print(json.dumps(found, indent=2, allow_nan=False))
        else:
            print_views(found)

    return service.run(act)


def print_views(found: Json) -> None:
    """Print each view as a camera's user sees it, and what it makes of the uncertainty."""
    console = output_console()
    for number, view in enumerate(found["suggestions"], 1):
        now, after = view["expected_uncertainty_now"], view["expected_uncertainty_after"]
        u, v = view["target_middle_px"]
        console.print(
            f"{number}. {view['view_distance_mm']:.0f} mm away, tilted {view['view_tilt_deg']:.0f}°, the target's "
            f"middle at ({u:.0f}, {v:.0f}) px: {now['projection_rms_px']:.2f} -> {after['projection_rms_px']:.2f} px"
        )
