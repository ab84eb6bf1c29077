"""`gridpose upload`: the images of a folder to a session, and a list of those that failed."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ... import (
    ClientError,
    ImageFile,
    Json,
    PatternError,
    ServiceClient,
    SessionResult,
    UploadResult,
    collect_results,
    find_or_make_session,
    plan_files,
    session_cameras,
    upload_files,
)
from ...files import number_cycles
from ...resources import check_target, existing_session
from ...upload import sha256_of
from ..access import UploadAccess
from ..console import OptionRefused, error_console, print_error
from .intention import FirstCycle, confirm, show_intention
from .outcome import report


class CycleOrder(enum.StrEnum):
    """Orders in which images are numbered."""

    name = "name"
    time = "time"
    none = "none"


def upload(
    folder: Annotated[
        Path, typer.Argument(help="Folder of images; sub-folders are poses.", exists=True, file_okay=False)
    ],
    session: Annotated[
        str, typer.Option(help="Id or name of the session; a new name creates one, given --target.")
    ],
    service: UploadAccess,
    target: Annotated[
        str | None,
        typer.Option(
            help="Target's id or name, or a new one by its form, e.g. chessboard:9x6:25 or "
            "charuco:9x6:25,marker=18,dictionary=DICT_5X5_100."
        ),
    ] = None,
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
    console = Console(stderr=True, highlight=False)
    try:
        plan = plan_files(folder, pattern, pose, first_cycle=first_cycle)
    except PatternError as error:
        print_error(console, str(error))
        return 2
    if not plan.images and not plan.skipped:
        print_error(console, f"No PNG, JPEG, TIFF or BMP files in {folder}.")
        return 2
    made: str | None = None
    errors = error_console()
    try:
        with service.client(errors) as client:
            found = existing_session(client, session)
            if target is not None:
                check_target(client, target)
            elif found is None:
                find_or_make_session(client, session, None)  # says that a new session needs a target
            images = (
                plan.images if cycles is CycleOrder.none else numbered(client, found, plan.images, cycles)
            )
            count = sum(
                one.cycle is not None and old.cycle is None
                for one, old in zip(images, plan.images, strict=True)
            )
            show_intention(errors, images, plan, session if found else f"{session} (new)", target, count)
            if dry_run:
                return 0
            confirm(yes=yes)
            session_id, target_id = find_or_make_session(
                client, session, target, accept_implausible=accept_implausible
            )
            made = session_id if found is None else None
            with transfer_progress(console) as progress:
                results, measured = transfer(
                    client,
                    session_id,
                    images,
                    progress,
                    target_id=target_id,
                    focus_group=focus_group,
                    parallel=parallel,
                    wait=wait,
                )
            cameras = session_cameras(client, session_id) if measured is not None else None
            if made and all(result.status == "failed" for result in results):
                remove_empty(client, errors, made)
    except OptionRefused as refused:
        print_error(console, str(refused), refused.advice)
        return 2
    except ClientError as error:
        print_error(console, str(error), error.advice)
        if made:
            with service.client(errors) as client:
                remove_empty(client, errors, made)
        return 1
    return report(console, plan, results, measured, cameras, session_id)


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


def remove_empty(client: ServiceClient, console: Console, session_id: str) -> None:
    """Delete a session that was made for an upload of which nothing arrived; say so where the key may not."""
    try:
        counts = client.get(f"/v1/sessions/{session_id}")["counts"]
        if sum(counts.values()):
            return
        client.delete(f"/v1/sessions/{session_id}")
        console.print("nothing was stored: the new session is deleted again")
    except ClientError as error:
        console.print(f"the new session {session_id} is left empty: {escape(str(error))}")


def transfer_progress(console: Console) -> Progress:
    """Return the progress bars of an upload: hashing, sending, computing."""
    return Progress(
        TextColumn("{task.description:<20}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(compact=True),
        console=console,
    )


def transfer(
    client: ServiceClient,
    session_id: str,
    images: Sequence[ImageFile],
    progress: Progress,
    *,
    target_id: str | None = None,
    focus_group: str | None = None,
    parallel: int = 2,
    wait: bool,
) -> tuple[list[UploadResult], SessionResult | None]:
    """Hash and send images and, with `wait`, collect the results, each with its progress bar."""
    hashing = progress.add_task("reading files", total=len(images))
    sending = progress.add_task("uploading", total=len(images))
    results = upload_files(
        client,
        session_id,
        images,
        target_id=target_id,
        focus_group=focus_group,
        parallel=parallel,
        on_hashed=lambda file: progress.advance(hashing),
        on_done=lambda result: progress.advance(sending),
    )
    if not wait:
        return results, None
    computing = progress.add_task("computing", total=None)

    def advance(done: int, of: int) -> None:
        progress.update(computing, completed=done, total=of)

    return results, collect_results(client, session_id, results, on_progress=advance)
