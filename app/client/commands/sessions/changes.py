"""`gridpose sessions change`, `reprocess` and `delete`."""

from __future__ import annotations

from typing import Annotated

import typer

from ... import Json, find_robot, find_session
from ...http import insisting_query
from ...resources import find_or_make_targets
from ..access import AdminAccess, UploadAccess
from ..console import OptionRefused, confirm_deletion
from ..creation import AcceptImplausible, ChangesFile
from ..record_files import read_mapping
from .mounts import CameraMount

Session = Annotated[str, typer.Argument(help="Id or name of the session.")]


def change(
    session: Session,
    service: UploadAccess,
    target: Annotated[
        list[str] | None,
        typer.Option(
            help="The session's target: an id, a name, sheet: and the id on its print, or its form, e.g. "
            "chessboard:9x6:25, which is made where the service has no such target. Repeat it for several; they "
            "replace those the session has."
        ),
    ] = None,
    robot: Annotated[
        str | None, typer.Option(help="Id or name of the session's robot; an empty text: none.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="The session's new name.")] = None,
    camera_mount: Annotated[
        CameraMount | None, typer.Option(help="Whether the camera is on the robot, or fixed before it.")
    ] = None,
    file: ChangesFile = None,
    accept_implausible: AcceptImplausible = False,
) -> None:
    """Change a session's targets, robot, name, camera mount, lens or conditions.

    Images whose target went are searched again. Commanded poses stay as they are: of the flange in the base.

    Lens, intrinsics and conditions are those of a --file.
    """
    with service.connect(file) as client:
        changes: Json = read_mapping(file) if file is not None else {}
        if camera_mount is not None:
            changes["camera_mount"] = camera_mount.value
        if target is None and robot is None and name is None and not changes:
            raise OptionRefused(
                "Nothing is to be changed.", "Give --target, --robot, --name, --camera-mount or --file."
            )
        session_id = find_session(client, session)["id"]
        if target is not None:
            changes["target_ids"] = find_or_make_targets(client, target)
        if robot is not None:
            changes["robot_id"] = find_robot(client, robot)["id"] if robot else None
        if name is not None:
            changes["name"] = name
        changed = client.change(f"/v1/sessions/{session_id}{insisting_query(accept_implausible)}", changes)
        print(f"{session_id} changed; {changed['counts']['queued']} images wait to be computed")


def reprocess(
    session: Session,
    service: UploadAccess,
    everything: Annotated[
        bool, typer.Option("--all", help="All measurements, not only those that failed.")
    ] = False,
) -> None:
    """Compute a session's failed measurements again, or all; results stay until others replace them."""
    with service.connect() as client:
        session_id = find_session(client, session)["id"]
        only = "all" if everything else "failed"
        queued = client.create(f"/v1/sessions/{session_id}/reprocess", {"only": only})["requeued"]
        print(f"{session_id}: {queued} measurements queued again")


def delete(
    session: Session,
    service: AdminAccess,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
) -> None:
    """Delete a session with everything in it."""
    with service.connect() as client:
        found = find_session(client, session)
        if not yes:
            images = sum(found["counts"].values())
            question = f"Delete {found['name']} ({found['id']}) with {images} measurements?"
            confirm_deletion(question)
        client.delete(f"/v1/sessions/{found['id']}")
        print(f"{found['id']} deleted")
