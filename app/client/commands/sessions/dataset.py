"""`gridpose sessions import`: images and robot poses of a dataset to a session."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from ... import FilePlan, ServiceClient
from ...resources import check_target, existing_session
from ..access import UploadAccess
from ..console import OptionRefused, error_console
from ..images.intention import SESSION, TargetOption, confirm
from ..images.outcome import report
from ..images.transfer import send_images
from .layouts import Dataset, Layout, read_dataset


def import_dataset(
    folder: Annotated[Path, typer.Argument(help="Folder of the dataset.", exists=True, file_okay=False)],
    layout: Annotated[Layout, typer.Option(help="The program whose layout it has.")],
    service: UploadAccess,
    session: Annotated[str | None, SESSION] = None,
    target: TargetOption = None,
    fixed_camera: Annotated[
        bool,
        typer.Option(
            "--fixed-camera",
            help="The camera stands still and the target moves with the robot (eye to hand): the session's "
            "camera_mount is fixed, and hand-eye calibration gives the camera in the robot's base.",
        ),
    ] = False,
    wait: Annotated[
        bool, typer.Option("--wait", help="Wait for the results and list the images that failed.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be sent, and send nothing.")
    ] = False,
) -> int:
    """Send a dataset of hand-eye calibration in another program's layout: its images, and the robot's pose at each.

    Prints the session's id as the last line; repeating sends what is missing.
    """
    with service.connect() as client:
        found = None if session is None or dry_run else existing_session(client, session)
        known_fixed = found is not None and found["camera_mount"] == "fixed"
        dataset = read_dataset(folder, layout, fixed_camera=fixed_camera or known_fixed)
        _say(error_console(), dataset)
        if dry_run:
            return 0
        if session is None:
            raise OptionRefused("No session was given.", "Give --session, its id or its name, or --dry-run.")
        confirm(yes=yes)
        if target is not None:
            check_target(client, target)
        sent = send_images(
            client,
            session,
            target,
            dataset.images,
            is_new=found is None,
            before=lambda session_id: _state_robot(client, session_id, dataset),
            wait=wait,
        )
    return report(Console(stderr=True, highlight=False, emoji=False), FilePlan(dataset.images, (), 0), sent)


def _state_robot(client: ServiceClient, session_id: str, dataset: Dataset) -> None:
    """State what the camera is on, and the robot's poses."""
    if dataset.fixed_camera:
        client.change(f"/v1/sessions/{session_id}", {"camera_mount": "fixed"})
    # The layout says in which units poses are.
    client.put_poses(session_id, list(dataset.poses), accept_implausible=True)


def _say(console: Console, dataset: Dataset) -> None:
    console.print(f"{len(dataset.images)} images, each with the robot's pose")
    for names, what in (
        (dataset.without_pose, "images have no pose"),
        (dataset.without_image, "poses have no image"),
    ):
        if names:
            shown = ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")
            console.print(escape(f"{len(names)} {what} and are not sent: {shown}"))
    if dataset.fixed_camera:
        console.print("The camera stands still, and the target is on the robot's flange.")
