"""Images to a session, with progress bars; a session that was made for them and got none is deleted again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ... import (
    ClientError,
    ImageFile,
    Json,
    ServiceClient,
    SessionResult,
    UploadResult,
    collect_results,
    find_or_make_session,
    session_cameras,
    upload_files,
)


@dataclass(frozen=True, slots=True)
class Transferred:
    """What became of images; `measured` and `cameras` only where their results were waited for. `excluded` are those
    measurements that do not count in the cameras.

    `session_id` is None where the session was made for them and is deleted again.
    """

    session_id: str | None
    results: list[UploadResult]
    measured: SessionResult | None
    cameras: list[Json] | None
    excluded: list[Json]


def send_images(
    client: ServiceClient,
    session: str,
    target: str | None,
    images: Sequence[ImageFile],
    *,
    is_new: bool,
    accept_implausible: bool = False,
    before: Callable[[str], object] = lambda session_id: None,
    focus_group: str | None = None,
    parallel: int = 2,
    wait: bool,
) -> Transferred:
    """Send images to a session, and with `wait` collect their results.

    Parameters
    ----------
    session, target, accept_implausible
        As `find_or_make_session` takes them.
    is_new
        Whether the service has no such session yet.
    before
        Called with the session's id before images are sent.

    Raises ClientError.
    """
    session_id, target_id = find_or_make_session(
        client, session, target, accept_implausible=accept_implausible
    )
    console = Console(stderr=True, highlight=False, emoji=False)
    try:
        before(session_id)
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
    except ClientError:
        if is_new:
            _remove_empty(client, console, session_id)
        raise
    cameras, excluded = session_cameras(client, session_id) if measured is not None else (None, [])
    nothing = all(result.status == "failed" for result in results)
    deleted = is_new and nothing and _remove_empty(client, console, session_id)
    return Transferred(None if deleted else session_id, results, measured, cameras, excluded)


def _remove_empty(client: ServiceClient, console: Console, session_id: str) -> bool:
    """Delete a session that was made for an upload of which nothing arrived; return whether it is gone, and say so."""
    try:
        counts = client.get(f"/v1/sessions/{session_id}")["counts"]
        if sum(counts.values()):
            return False
        client.delete(f"/v1/sessions/{session_id}")
        console.print("nothing was stored: the new session is deleted again")
        return True
    except ClientError as error:
        console.print(f"the new session {session_id} is left empty: {escape(str(error))}")
        return False


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
