"""`gridpose watch`: what appears in a folder to a session, for months."""

from __future__ import annotations

import enum
import hashlib
import shlex
import signal
import threading
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from types import FrameType
from typing import Annotated

import platformdirs
import typer

from ... import ClientError, PatternError, ServiceClient
from ...credentials import saved_key
from ...images.files import compile_pattern
from ...watch import (
    CannotBegin,
    Journal,
    JournalInUse,
    JournalUnusable,
    Report,
    Watcher,
    WatchSettings,
    WatchSummary,
)
from ..access import UploadAccess
from ..console import error_console, print_error
from ..sessions.next_view import Purpose
from .intention import SESSION, FirstCycle, TargetOption


class Complete(enum.StrEnum):
    """What makes a file complete."""

    settled = "settled"
    renamed = "renamed"
    marker = "marker"


class Sidecar(enum.StrEnum):
    """Whether sidecar files and the table of poses are used."""

    auto = "auto"
    required = "required"
    off = "off"


@dataclass(frozen=True, slots=True, kw_only=True)
class FileOptions:
    """Options on files: which pose they are of, and when they are complete."""

    pattern: Annotated[
        str | None,
        typer.Option(
            help="Position of pose, cycle and burst index in the path, e.g. '{pose}_{cycle}'.  [default: by folder]"
        ),
    ] = None
    pose: Annotated[str | None, typer.Option(help="Pose ID of all files.")] = None
    focus_group: Annotated[str | None, typer.Option(help="Tag of images taken at one focus setting.")] = None
    complete: Annotated[
        Complete,
        typer.Option(
            help="When a file is complete: it stands still, it is renamed into place, or a marker file lies next to it."
        ),
    ] = Complete.settled
    settle_s: Annotated[float, typer.Option(help="How long a file stands still, seconds.", min=0.0)] = 2.0
    marker: Annotated[str, typer.Option(help="Suffix of marker files: P1.png.done or P1.done.")] = ".done"
    sidecar: Annotated[
        Sidecar,
        typer.Option(
            help="Metadata from NAME.json or NAME.csv next to an image, or its row in the table of poses; required: "
            "an image waits for them."
        ),
    ] = Sidecar.auto
    poses: Annotated[
        Path | None, typer.Option(help="Table of poses, which may grow.  [default: poses.csv in the folder]")
    ] = None
    first_cycle: FirstCycle = 1
    number_cycles: Annotated[
        bool,
        typer.Option("--number-cycles", help="Number images without a cycle, for each pose, as they come."),
    ] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultOptions:
    """Options on what happens to files that were sent, and to results."""

    move_to: Annotated[
        Path | None,
        typer.Option(
            help="Move files here once measured; the others to not-measured below it.", file_okay=False
        ),
    ] = None
    delete_measured: Annotated[
        bool, typer.Option("--delete-measured", help="Delete files once measured; those not measured stay.")
    ] = False
    live: Annotated[
        bool, typer.Option("--live", help="Print each result in one line, with what to change.")
    ] = False
    bell: Annotated[bool, typer.Option("--bell", help="Ring the bell for an image without result.")] = False
    next_view: Annotated[
        Purpose | None,
        typer.Option(
            help="After results print where the next image helps most; each answer is a computation."
        ),
    ] = None
    on_result: Annotated[
        str | None,
        typer.Option(help="Command that gets each result as JSON on standard input; run without a shell."),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """Options on the run itself."""

    once: Annotated[
        bool,
        typer.Option(
            "--once", help="End when nothing is left to do; 1 if something was not sent or measured."
        ),
    ] = False
    parallel: Annotated[int, typer.Option("--jobs", help="Number of parallel uploads.", min=1, max=16)] = 2
    poll_s: Annotated[float, typer.Option(help="Pause between two looks, seconds.", min=0.05)] = 1.0
    journal: Annotated[
        Path | None,
        typer.Option(
            help="Journal of what was sent, on a local disk.  [default: one a folder, in the user's state]"
        ),
    ] = None
    state_file: Annotated[
        Path | None,
        typer.Option(help="JSON on how it goes, for monitoring.  [default: next to the journal]"),
    ] = None


def watch(
    folder: Annotated[Path, typer.Argument(help="Folder to watch, with its sub-folders.", file_okay=False)],
    session: Annotated[str, SESSION],
    service: UploadAccess,
    files: FileOptions,
    results: ResultOptions,
    run: RunOptions,
    target: TargetOption = None,
) -> int:
    """Send each image that appears in a folder, once, until stopped; it may run for months.

    A journal keeps what was sent, over restarts and power cuts. While the service is away, images wait in the folder.
    Lines are printed on stdout: one a minute, and one when something goes wrong or works again.
    """
    console = error_console()
    try:
        matcher = None
        if files.pattern is not None:
            matcher = compile_pattern(files.pattern, needs_pose=files.pose is None)
        if results.move_to is not None and results.delete_measured:
            raise CannotBegin(
                "Measured files are to be moved and deleted.", "Give --move-to or --delete-measured."
            )
        if results.on_result is not None:
            _check_command(results.on_result)
        if run.once and not folder.is_dir():
            raise CannotBegin(f"There is no folder {folder}.", "Check the path.")
        settings = _settings(folder, session, target, service, files, results, run)
        return _watch(replace(settings, matcher=matcher), service, results.bell, run)
    except PatternError as error:
        print_error(console, str(error))
    except CannotBegin as error:
        print_error(console, str(error), error.advice)
    except ClientError as error:
        print_error(console, str(error), error.advice)
        return 1
    except JournalInUse as error:
        print_error(
            console, str(error), "End the other one, or give --journal for a second session of this folder."
        )
    except JournalUnusable as error:
        print_error(console, str(error), "Give a file in a folder that can be written: --journal FILE.")
    return 2


def _check_command(command: str) -> None:
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise CannotBegin(
            f"--on-result {command} cannot be split into words: {error}.", "Close its quotes."
        ) from None
    if not words:
        raise CannotBegin("--on-result names no command.", "Give a program with its options.")


def _settings(
    folder: Path,
    session: str,
    target: str | None,
    service: UploadAccess,
    files: FileOptions,
    results: ResultOptions,
    run: RunOptions,
) -> WatchSettings:
    after = "move" if results.move_to is not None else "delete" if results.delete_measured else "keep"
    return WatchSettings(
        folder=folder,
        session=session,
        target=target,
        pose_id=files.pose,
        focus_group=files.focus_group,
        complete=files.complete.value,
        settle_s=files.settle_s,
        marker=files.marker,
        sidecar=files.sidecar.value,
        table=files.poses,
        first_cycle=files.first_cycle,
        number_cycles=files.number_cycles,
        after=after,  # type: ignore[arg-type]
        moved_to=results.move_to,
        live=results.live or results.bell,
        next_view=None if results.next_view is None else results.next_view.value,
        on_result=results.on_result,
        once=run.once,
        parallel=run.parallel,
        poll_s=run.poll_s,
        give_up_s=service.retry_for,
    )


def _watch(settings: WatchSettings, service: UploadAccess, bell: bool, run: RunOptions) -> int:
    path = run.journal or default_journal(settings.folder, service.url)
    journal = Journal(path)
    state_file = run.state_file or path.with_suffix(".state.json")
    facts = {"folder": str(settings.folder), "session": settings.session, "service": service.url}
    report = Report(_say, state_file, {**facts, "journal": str(path)})
    report.say(f"watching {settings.folder} for session {settings.session} of {service.url}")
    report.say(f"journal {path}, state {state_file}")
    if journal.replaced is not None:
        report.say(
            f"the journal was damaged and is kept as {journal.replaced}; the service is asked what it has"
        )
    stop = threading.Event()
    _end_by_signals(stop)
    try:
        with ServiceClient(service.url, service.key or saved_key(service.url), retry_for_s=0.0) as client:
            on_failed = _ring if bell else lambda: None
            summary = Watcher(client, journal, report, settings, on_failed=on_failed).run(stop)
    finally:
        journal.close()
    return _exit_code(summary, report, once=settings.once)


def _exit_code(summary: WatchSummary, report: Report, *, once: bool) -> int:
    if summary.gave_up:
        report.say(
            "gave up: for longer than --retry-timeout the service was away or refused; run it again to continue"
        )
        return 1
    if not once:
        report.say("stopped; what is not sent yet is sent by the next run")
        return 0
    if summary.session_id is not None:
        print(summary.session_id)
    unsent = summary.refused or summary.waiting or report.troubles("folder")
    return 1 if unsent or summary.failed else 0


def default_journal(folder: Path, url: str) -> Path:
    """Return the journal's usual place: one for each folder and service, in the user's state on this machine's disk."""
    key = f"{folder.resolve()}\n{url.rstrip('/')}".encode("utf-8", "surrogatepass")
    name = f"{folder.resolve().name or 'root'}-{hashlib.sha256(key).hexdigest()[:12]}.sqlite"
    return platformdirs.user_state_path("gridpose", appauthor=False) / "watch" / name


def _end_by_signals(stop: threading.Event) -> None:
    """Let the signals that end programs set `stop`; a second one ends the program at once."""

    def end(number: int, _: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    for name in ("SIGINT", "SIGTERM", "SIGBREAK"):  # the last is of Windows
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), end)


def _say(line: str) -> None:
    # Names may hold line ends and control characters: a line stays one, and does nothing to a terminal.
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    print(f"{datetime.now().astimezone():%Y-%m-%d %H:%M:%S} {shown}", flush=True)


def _ring() -> None:
    print("\a", end="", flush=True)
