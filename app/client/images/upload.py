"""Send images to a session, once each, and collect their results.

The service is first asked by hash which images it lacks: an interrupted upload continues where it stopped, and a
repeated one sends nothing.
"""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Literal

from ..http import ClientError, Json, ServiceClient
from .files import ImageFile
from .sizes import require_readable_size

_READ_BYTES = 1 << 20
_POLL_S = (0.2, 2.0)
_STALLED_S = 600.0

# Refusals that concern the key or the session, not one image: every further image would be refused too.
_FATAL_STATUSES = frozenset({401, 403, 404, 405})


@dataclass(frozen=True, slots=True)
class UploadResult:
    """Result of one file's upload. `sha256` is None where the file could not be read."""

    file: ImageFile
    status: Literal["sent", "present", "failed"]
    sha256: str | None
    reason: str | None = None
    advice: str | None = None

    @property
    def name(self) -> str:
        return self.file.name


@dataclass(frozen=True, slots=True)
class SessionResult:
    """The measurements of the uploaded images, in the session's order."""

    measurements: tuple[Json, ...]

    @property
    def succeeded(self) -> list[Json]:
        return [m for m in self.measurements if m["status"] == "succeeded"]

    @property
    def duplicates(self) -> list[Json]:
        """Failed only because their image already has a measurement of every target in it."""
        return [m for m in self.measurements if _is_already_measured(m)]

    @property
    def failed(self) -> list[Json]:
        """All other failures: those a user has to act on."""
        return [m for m in self.measurements if m["status"] == "failed" and not _is_already_measured(m)]


def upload_files(
    client: ServiceClient,
    session_id: str,
    images: Sequence[ImageFile],
    *,
    target_id: str | None = None,
    focus_group: str | None = None,
    parallel: int = 2,
    on_hashed: Callable[[ImageFile], None] = lambda file: None,
    on_done: Callable[[UploadResult], None] = lambda outcome: None,
) -> list[UploadResult]:
    """Upload the images that the session lacks; return a result for every file, in the order given.

    A failure of one image does not stop the others, unless it concerns the key, the session or the connection.
    `on_done` is called from the uploading threads, one call at a time.
    """
    hashes: dict[ImageFile, str] = {}
    outcomes: dict[ImageFile, UploadResult] = {}
    lock = threading.Lock()
    stopped: list[ClientError] = []

    def finish(outcome: UploadResult) -> None:
        with lock:
            outcomes[outcome.file] = outcome
            on_done(outcome)

    for file in images:
        try:
            hashes[file] = sha256_of(file)
        except OSError as error:
            finish(UploadResult(file, "failed", None, f"cannot be read: {error.strerror or error}"))
        on_hashed(file)

    wanted = client.missing_images(
        session_id, sorted({(f.pose_id, h) for f, h in hashes.items()}), target_id=target_id
    )
    first: dict[tuple[str, str], ImageFile] = {}
    copies: list[tuple[ImageFile, ImageFile]] = []  # a second copy in the folder is not sent
    for file, sha256 in hashes.items():
        image = (file.pose_id, sha256)
        if image not in wanted:
            finish(UploadResult(file, "present", sha256))
        elif image in first:
            copies.append((file, first[image]))
        else:
            first[image] = file

    def send(file: ImageFile) -> None:
        if stopped:
            finish(
                UploadResult(
                    file, "failed", hashes[file], f"not sent: {stopped[0].detail}", stopped[0].advice
                )
            )
            return
        sha256 = hashes[file]
        try:
            data = file.path.read_bytes()
            # The file may have changed since it was hashed: the hash must be that of the bytes sent.
            sha256 = hashlib.sha256(data).hexdigest()
            client.put_image(
                session_id,
                file.pose_id,
                sha256,
                data,
                cycle=file.cycle,
                burst=file.burst,
                target_id=target_id,
                focus_group=focus_group,
                filename=_printable(file.path.name),
                pose_label=file.label and _printable(file.label[:200]),
            )
        except OSError as error:
            finish(UploadResult(file, "failed", sha256, f"cannot be read: {error.strerror or error}"))
        except ClientError as error:
            if error.status in _FATAL_STATUSES or error.code == "unreachable":
                stopped.append(error)
            finish(UploadResult(file, "failed", sha256, str(error), error.advice))
        else:
            finish(UploadResult(file, "sent", sha256))

    pool = ThreadPoolExecutor(max_workers=parallel, thread_name_prefix="upload")
    try:
        for future in [pool.submit(send, file) for file in first.values()]:
            future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    for file, sent in copies:
        of_sent = outcomes[sent]
        finish(replace(of_sent, file=file, status="present" if of_sent.status == "sent" else of_sent.status))
    return [outcomes[file] for file in images]


def collect_results(
    client: ServiceClient,
    session_id: str,
    outcomes: Sequence[UploadResult],
    *,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> SessionResult:
    """Wait until every uploaded image is calibrated or has failed, and return their measurements.

    Raises
    ------
    ClientError
        `no_progress` where no image was finished for ten minutes, usually because no worker runs.
    """
    ours = {(o.file.pose_id, o.sha256) for o in outcomes if o.status != "failed"}
    pause_s, longest_s = _POLL_S
    last_done, last_change = -1, time.monotonic()
    while True:
        done = len(ours) - len(_unfinished(client, session_id) & ours)
        on_progress(done, len(ours))
        if done == len(ours):
            found = tuple(
                m
                for m in client.items(f"/v1/sessions/{session_id}/measurements")
                if (m["pose_id"], m["sha256"]) in ours
            )
            # An image that went from running back to queued between the two lists is in neither of them.
            if all(m["status"] in ("succeeded", "failed") for m in found):
                return SessionResult(found)
        if done != last_done:
            last_done, last_change = done, time.monotonic()
            pause_s = _POLL_S[0]
        elif time.monotonic() - last_change > _STALLED_S:
            raise ClientError(
                "no_progress",
                f"{len(ours) - done} images are waiting and none was finished for {_STALLED_S:.0f} s.",
                "Check that a worker runs: see /readyz; GRIDPOSE_WORKERS=0 starts none.",
            )
        time.sleep(pause_s)
        pause_s = min(1.5 * pause_s, longest_s)


def _is_already_measured(measurement: Json) -> bool:
    failure = measurement["failure"]
    return failure is not None and failure["code"] == "target_already_measured"


def _unfinished(client: ServiceClient, session_id: str) -> set[tuple[str, str | None]]:
    path = f"/v1/sessions/{session_id}/measurements"
    return {
        (m["pose_id"], m["sha256"])
        for status in ("queued", "running")
        for m in client.items(path, status=status)
    }


def _printable(name: str) -> str | None:
    """Return a file's name without what no JSON or address holds: control characters, bytes that are not text."""
    return "".join(c for c in name if c.isprintable()) or None


def sha256_of(file: ImageFile) -> str:
    """Return the SHA-256 of a file as hex digits. Raises OSError, also for a file that is too large for an image."""
    digest = hashlib.sha256()
    with file.path.open("rb") as stream:
        require_readable_size(stream)
        while chunk := stream.read(_READ_BYTES):
            digest.update(chunk)
    return digest.hexdigest()
