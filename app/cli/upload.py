"""`gridpose upload`: options to a session and a list of files, and a report a person can act on."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import stamina
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from app.agent import (
    ClientError,
    FilePlan,
    ImageFile,
    Json,
    Outcome,
    PatternError,
    ServiceClient,
    SessionResult,
    collect_results,
    plan_files,
    upload_files,
)

_TARGET = re.compile(r"(?P<kind>[a-z_]+):(?P<columns>[0-9]+)x(?P<rows>[0-9]+):(?P<pitch>[0-9]+(\.[0-9]+)?)")


@dataclass(frozen=True, slots=True)
class Request:
    """The options of `gridpose upload`."""

    folder: Path
    session: str
    url: str
    key: str | None
    target: str | None
    pattern: str | None
    pose: str | None
    focus_group: str | None
    parallel: int
    retry_for_s: float
    wait: bool


def upload(request: Request) -> int:
    """Upload a folder; return the exit code."""
    console = Console(stderr=True, highlight=False)
    stamina.instrumentation.set_on_retry_hooks([])  # the progress bar says it, in one line
    try:
        plan = plan_files(request.folder, request.pattern, request.pose)
    except PatternError as error:
        console.print(f"[red]{escape(str(error))}[/]")
        return 2
    if not plan.images and not plan.skipped:
        console.print(f"[red]No PNG, JPEG, TIFF or BMP files in {escape(str(request.folder))}.[/]")
        return 2
    try:
        with transfer_progress(console) as progress:
            client = ServiceClient(
                request.url,
                request.key,
                retry_for_s=request.retry_for_s,
                on_retry=lambda reason: progress.console.print(f"[yellow]trying again: {escape(reason)}[/]"),
            )
            with client:
                session_id, target_id = find_or_make_session(client, request.session, request.target)
                outcomes, result = transfer(
                    client,
                    session_id,
                    plan.images,
                    progress,
                    target_id=target_id,
                    focus_group=request.focus_group,
                    parallel=request.parallel,
                    wait=request.wait,
                )
    except ClientError as error:
        console.print(f"[red]{escape(str(error))}[/]")
        if error.advice:
            console.print(escape(error.advice))
        return 1
    return _report(console, plan, outcomes, result, session_id)


def transfer_progress(console: Console) -> Progress:
    """Return the bars of an upload: hashing, sending, computing."""
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
) -> tuple[list[Outcome], SessionResult | None]:
    """Hash, send and, where asked, wait for the results, each with its bar."""
    hashing = progress.add_task("reading files", total=len(images))
    sending = progress.add_task("uploading", total=len(images))
    outcomes = upload_files(
        client,
        session_id,
        images,
        target_id=target_id,
        focus_group=focus_group,
        parallel=parallel,
        on_hashed=lambda file: progress.advance(hashing),
        on_done=lambda outcome: progress.advance(sending),
    )
    if not wait:
        return outcomes, None
    computing = progress.add_task("computing", total=None)

    def advance(done: int, of: int) -> None:
        progress.update(computing, completed=done, total=of)

    return outcomes, collect_results(client, session_id, outcomes, on_progress=advance)


def find_or_make_session(client: ServiceClient, session: str, target: str | None) -> tuple[str, str | None]:
    """Return the session's id, and the target's id where one was named.

    `session` is an id, or the name of exactly one session; a name that none has is made, for which a target
    is needed. `target` is an id, or a description (`chessboard:9x6:25`) of one that may have to be made.
    """
    found = _session_named(client, session)
    if found is not None:
        return found["id"], _target_of(client, found, target)
    if target is None:
        raise ClientError(
            "session_not_found",
            f"No session has the id or the name {session!r}.",
            "To make it, say what is in view, e.g. --target chessboard:9x6:25 (inner corners, mm).",
        )
    target_id = _find_or_make_target(client, target)
    created = client.create("/v1/sessions", {"name": session, "target_ids": [target_id]})
    return created["id"], target_id


def find_session(client: ServiceClient, session: str) -> Json:
    """Return the session with this id, or the only one with this name; ClientError where there is none."""
    found = _session_named(client, session)
    if found is None:
        raise ClientError(
            "session_not_found",
            f"No session has the id or the name {session!r}.",
            "Check the name, or give the id; GET /v1/sessions lists them.",
        )
    return found


def _session_named(client: ServiceClient, session: str) -> Json | None:
    named = []
    for entry in client.items("/v1/sessions"):
        if entry["id"] == session:
            return entry
        if entry["name"] == session:
            named.append(entry)
    if len(named) > 1:
        ids = ", ".join(entry["id"] for entry in named)
        raise ClientError(
            "session_ambiguous", f"Several sessions are named {session!r}: {ids}.", "Give the id."
        )
    return named[0] if named else None


def _target_of(client: ServiceClient, session: Json, target: str | None) -> str | None:
    """Return which of the session's targets was named; None where none was."""
    if target is None:
        return None
    if target in session["target_ids"]:
        return target
    wanted = _described_target(target)
    if wanted is not None:
        for target_id in session["target_ids"]:
            if _is_described(client.get(f"/v1/targets/{target_id}"), wanted):
                return str(target_id)
    raise ClientError(
        "target_not_in_session",
        f"The session does not look for the target {target}.",
        "Leave --target away to use the session's own, or name a new session.",
    )


def _find_or_make_target(client: ServiceClient, target: str) -> str:
    wanted = _described_target(target)
    if wanted is None:
        return target
    for entry in client.items("/v1/targets"):
        if _is_described(entry, wanted):
            return str(entry["id"])
    return str(client.create("/v1/targets", {"name": target, **wanted})["id"])


def _described_target(text: str) -> Json | None:
    """Return the target that `KIND:COLUMNSxROWS:PITCH_MM` describes, or None for any other text."""
    match = _TARGET.fullmatch(text)
    if match is None:
        return None
    return {
        "kind": match["kind"],
        "columns": int(match["columns"]),
        "rows": int(match["rows"]),
        "pitch_mm": float(match["pitch"]),
    }


def _is_described(target: Json, wanted: Json) -> bool:
    return all(target[field] == value for field, value in wanted.items())


def _report(
    console: Console, plan: FilePlan, outcomes: list[Outcome], result: SessionResult | None, session_id: str
) -> int:
    sent = sum(o.status == "sent" for o in outcomes)
    present = sum(o.status == "present" for o in outcomes)
    failed = [(o.name, o.reason or "", o.advice) for o in outcomes if o.status == "failed"]
    failed += [(s.name, s.reason, "Rename it, or give --pattern or --pose.") for s in plan.skipped]
    console.print(f"session {session_id}: {sent} sent, {present} already there, {len(failed)} failed")
    if plan.others:
        console.print(f"other files, which are no images by their names and were left: {plan.others}")
    refused = []
    if result is not None:
        names = {(o.file.pose_id, o.sha256): o.name for o in outcomes}
        refused = [
            (
                names[m["pose_id"], m["sha256"]],
                f"{m['failure']['detail']} ({m['failure']['code']})",
                m["failure"]["advice"],
            )
            for m in result.failed
        ]
        console.print(f"{len(result.succeeded)} calibrated, {len(refused)} refused")
        if result.already_measured:
            console.print(
                f"{len(result.already_measured)} measured before, under the names of their targets: nothing to do"
            )
    for title, rows in (("Not uploaded", failed), ("Refused by the calibration", refused)):
        if rows:
            console.print(_list(title, rows))
    return 1 if failed or refused else 0


def _list(title: str, rows: list[tuple[str, str, str | None]]) -> Table:
    table = Table(title=title, title_justify="left", show_lines=True)
    for column in ("file", "reason", "what to do"):
        table.add_column(column, overflow="fold")
    for name, reason, advice in rows:
        table.add_row(escape(name), escape(reason), escape(advice or ""))
    return table
