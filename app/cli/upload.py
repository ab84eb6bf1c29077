"""`gridpose upload`: the images of a folder to a session, and a list of those that failed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from app.cli.client_options import UploadAccess
from app.cli.console import print_error
from app.client import (
    ClientError,
    FilePlan,
    ImageFile,
    Json,
    PatternError,
    ServiceClient,
    SessionResult,
    UploadResult,
    collect_results,
    describe_measured,
    find_or_make_session,
    is_measured,
    plan_files,
    session_cameras,
    upload_files,
)


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
        typer.Option(help="Target's id, or a new one as KIND:COLUMNSxROWS:PITCH_MM, e.g. chessboard:9x6:25."),
    ] = None,
    accept_implausible: Annotated[
        bool,
        typer.Option("--accept-implausible", help="Create --target even if its pitch looks like metres."),
    ] = False,
    pattern: Annotated[
        str | None,
        typer.Option(
            help="Position of pose and cycle in the path, e.g. '{pose}_{cycle}' or '{any}/{pose}-{cycle}'."
        ),
    ] = None,
    pose: Annotated[str | None, typer.Option(help="Pose ID of all files.")] = None,
    focus_group: Annotated[str | None, typer.Option(help="Tag of images taken at one focus setting.")] = None,
    parallel: Annotated[int, typer.Option("--jobs", help="Number of parallel uploads.", min=1, max=16)] = 2,
    wait: Annotated[
        bool, typer.Option("--wait", help="Wait for the results and list the images that failed.")
    ] = False,
) -> int:
    """Send a folder's images to a session, once each; repeat it to continue after an interruption.

    Prints the session's id as the last line. Ends with 0 when every image is stored (and, with --wait, measured), else
    with 1 and a list.
    """
    console = Console(stderr=True, highlight=False)
    try:
        plan = plan_files(folder, pattern, pose)
    except PatternError as error:
        print_error(console, str(error))
        return 2
    if not plan.images and not plan.skipped:
        print_error(console, f"No PNG, JPEG, TIFF or BMP files in {folder}.")
        return 2
    try:
        with (
            transfer_progress(console) as progress,
            service.client(progress.console) as client,
        ):
            session_id, target_id = find_or_make_session(
                client, session, target, accept_implausible=accept_implausible
            )
            results, measured = transfer(
                client,
                session_id,
                plan.images,
                progress,
                target_id=target_id,
                focus_group=focus_group,
                parallel=parallel,
                wait=wait,
            )
            cameras = session_cameras(client, session_id) if measured is not None else None
    except ClientError as error:
        print_error(console, str(error), error.advice)
        return 1
    return _report(console, plan, results, measured, cameras, session_id)


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


def _report(
    console: Console,
    plan: FilePlan,
    results: list[UploadResult],
    measured: SessionResult | None,
    cameras: list[Json] | None,
    session_id: str,
) -> int:
    sent = sum(o.status == "sent" for o in results)
    present = sum(o.status == "present" for o in results)
    failed = [(o.name, o.reason or "", o.advice) for o in results if o.status == "failed"]
    failed += [
        (s.name, s.reason, "Rename it, give --pattern or --pose, or make it readable.") for s in plan.skipped
    ]
    console.print(f"session {session_id}: {sent} sent, {present} already there, {len(failed)} failed")
    for folder in plan.repeated:
        console.print(f"[yellow]not searched again: {escape(folder.name)}: {escape(folder.reason)}[/]")
    if plan.others:
        console.print(f"other files, not images by their names: {plan.others}")
    refused = []
    if measured is not None:
        names = {(o.file.pose_id, o.sha256): o.name for o in results}
        refused = [
            (
                names[m["pose_id"], m["sha256"]],
                f"{m['failure']['detail']} ({m['failure']['code']})",
                m["failure"]["advice"],
            )
            for m in measured.failed
            if not (cameras and is_measured(m))  # those serve: nothing is to be done about them
        ]
        console.print(describe_measured(measured.measurements, cameras))
        if refused:
            console.print(f"{len(refused)} refused")
        if measured.duplicates:
            console.print(f"{len(measured.duplicates)} already measured for every target: nothing to do")
    for title, rows in (("Not uploaded", failed), ("Refused", refused)):
        if rows:
            console.print(_list(title, rows))
    print(session_id)
    return 1 if failed or refused else 0


def _list(title: str, rows: list[tuple[str, str, str | None]]) -> Table:
    table = Table(title=title, title_justify="left", show_lines=True)
    for column in ("file", "reason", "what to do"):
        table.add_column(column, overflow="fold")
    for name, reason, advice in rows:
        table.add_row(escape(name), escape(reason), escape(advice or ""))
    return table
