"""`gridpose upload`: the images of a folder to a session, and a list of those that failed."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ... import (
    ImageFile,
    Json,
    PatternError,
    ServiceClient,
    find_or_make_session,
    plan_files,
)
from ...images.files import number_cycles
from ...images.upload import sha256_of
from ...resources import check_target, existing_session
from ..access import UploadAccess
from ..console import error_console, print_error
from .intention import SESSION, FirstCycle, TargetOption, confirm, show_intention
from .outcome import report
from .transfer import send_images


class CycleOrder(enum.StrEnum):
    """Orders in which images are numbered."""

    name = "name"
    time = "time"
    none = "none"


def upload(
    folder: Annotated[
        Path, typer.Argument(help="Folder of images; sub-folders are poses.", exists=True, file_okay=False)
    ],
    session: Annotated[str, SESSION],
    service: UploadAccess,
    target: TargetOption = None,
    accept_implausible: Annotated[
        bool,
        typer.Option("--accept-implausible", help="Create --target even if its pitch looks like metres."),
    ] = False,
    pattern: Annotated[
        str | None,
        typer.Option(
            help="Position of pose, cycle and burst index in the path, e.g. '{pose}_{cycle}' or "
            "'{any}/{pose}-{cycle}-{burst}'."
        ),
    ] = None,
    pose: Annotated[str | None, typer.Option(help="Pose ID of all files.")] = None,
    focus_group: Annotated[str | None, typer.Option(help="Tag of images taken at one focus setting.")] = None,
    parallel: Annotated[int, typer.Option("--jobs", help="Number of parallel uploads.", min=1, max=16)] = 2,
    wait: Annotated[
        bool, typer.Option("--wait", help="Wait for the results and list the images that failed.")
    ] = False,
    cycles: Annotated[
        CycleOrder,
        typer.Option(help="How images are numbered for each pose none of which has a cycle in its name."),
    ] = CycleOrder.name,
    first_cycle: FirstCycle = 1,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be sent, and send nothing.")
    ] = False,
) -> int:
    """Send a folder's images to a session, once each; repeat it to continue after an interruption.

    Prints the session's id as the last line. Ends with 0 when every image is stored (and, with --wait, measured), else
    with 1 and a list.
    """
    console = Console(stderr=True, highlight=False, emoji=False)
    try:
        plan = plan_files(folder, pattern, pose, first_cycle=first_cycle)
    except PatternError as error:
        print_error(console, str(error))
        return 2
    if not plan.images and not plan.skipped:
        print_error(console, f"No PNG, JPEG, TIFF or BMP files in {folder}.")
        return 2
    if not plan.images:
        first = plan.skipped[0]
        print_error(
            console,
            f"None of the {len(plan.skipped)} images in {folder} can be sent. {first.name}: {first.reason}",
        )
        return 2

    with service.connect() as client:
        found = existing_session(client, session)
        if target is not None:
            check_target(client, target)
        elif found is None:
            find_or_make_session(client, session, None)  # says that a new session needs a target
        images = plan.images if cycles is CycleOrder.none else numbered(client, found, plan.images, cycles)
        count = sum(
            one.cycle is not None and old.cycle is None for one, old in zip(images, plan.images, strict=True)
        )
        show_intention(error_console(), images, plan, session if found else f"{session} (new)", target, count)
        if dry_run:
            return 0
        confirm(yes=yes)
        sent = send_images(
            client,
            session,
            target,
            images,
            is_new=found is None,
            accept_implausible=accept_implausible,
            focus_group=focus_group,
            parallel=parallel,
            wait=wait,
        )
    return report(console, plan, sent)


def numbered(
    client: ServiceClient, found: Json | None, images: Sequence[ImageFile], order: CycleOrder
) -> list[ImageFile]:
    """Return the images with cycles where their poses have none, after the cycles that the session has.

    An image that the session has stays without one: it is not sent again.
    """
    by_time = order is CycleOrder.time
    bare = {i.pose_id for i in images} - {i.pose_id for i in images if i.cycle is not None}
    if found is None or not bare:
        return number_cycles(images, by_time=by_time)
    there: set[tuple[str, str]] = set()
    last: dict[str, int] = {}
    for m in client.items(f"/v1/sessions/{found['id']}/measurements"):
        there.add((m["pose_id"], m["sha256"]))
        last[m["pose_id"]] = max(last.get(m["pose_id"], 0), m["cycle"] or 0)
    fresh = [i for i in images if i.pose_id not in bare or (i.pose_id, sha256_of(i)) not in there]
    cycles = {i.path: i for i in number_cycles(fresh, by_time=by_time, after=last)}
    return [cycles.get(image.path, image) for image in images]
