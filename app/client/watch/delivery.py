"""One file to the service: read whole, tagged, sent, and entered in the journal after the acknowledgement."""

from __future__ import annotations

import hashlib
import json
import os
import threading
from dataclasses import dataclass, replace
from typing import Any

from ..http import ClientError, Json, ServiceClient
from ..images.files import (
    MAX_BURST,
    MAX_CYCLE,
    POSE_ID,
    counted_from,
    impossible_cycle,
    legal_pose_id,
    tag_of,
)
from ..images.sizes import require_readable_size
from .cycles import CycleNumbers
from .files import (
    Found,
    ImageMetadata,
    MetadataError,
    PoseTable,
    read_sidecar,
    sidecar_of,
    signature_of,
    why_incomplete,
)
from .gate import is_outage
from .journal import Entry, Journal
from .report import Report
from .settings import WatchSettings

_OF_KEY_OR_SESSION = (401, 404)


class FileNotReady(Exception):
    """The file cannot be sent now; the message gives the reason. It is tried again."""


class FileRefused(Exception):
    """The file can never be sent as it is; the message gives the reason."""


@dataclass(frozen=True, slots=True)
class Loaded:
    """A file's bytes and metadata; `label` is the name that its pose was given, where that is no pose ID."""

    found: Found
    sha256: str
    metadata: ImageMetadata
    pose_id: str
    data: bytes
    label: str | None = None


@dataclass(frozen=True, slots=True)
class SessionRun:
    """A run of the watcher, once the id of its session is known."""

    client: ServiceClient
    journal: Journal
    report: Report
    settings: WatchSettings
    session_id: str


class Delivery:
    """Sends files of one session; safe to use from several threads."""

    def __init__(self, run: SessionRun, target_id: str | None) -> None:
        self._run = run
        self._target_id = target_id
        self._numbers = CycleNumbers(run.client, run.journal, run.report, run.session_id)
        self._pose_lock = threading.Lock()
        self._refused_commands: dict[str, str] = {}
        self.table = PoseTable()
        """The rows that apply now; replaced whole by the watcher."""

    def load(self, found: Found) -> Loaded:
        """Read a file and determine its pose and metadata.

        Raises
        ------
        FileNotReady
            It is being written, was replaced meanwhile, or its sidecar is missing or unusable.
        FileRefused
            Its name gives no pose, an impossible cycle, or a burst index without a cycle.
        OSError
            It cannot be read.
        """
        metadata = self._metadata(found)
        with found.path.open("rb") as stream:
            require_readable_size(stream)
            before = signature_of(os.fstat(stream.fileno()))
            data = stream.read()
            after = signature_of(os.fstat(stream.fileno()))
        if before != after or _without_identity(before) != _without_identity(found.signature):
            raise FileNotReady("it is being written to")
        if reason := why_incomplete(data):
            raise FileNotReady(f"not whole: {reason}")
        if not metadata.pose_id:
            raise FileRefused(f"its name gives no pose; {_advice(self._run.settings)}")
        pose_id, changed = legal_pose_id(metadata.pose_id)
        if not POSE_ID.fullmatch(pose_id):
            raise FileRefused(f"{metadata.pose_id!r} is not a pose ID; {_advice(self._run.settings)}")
        if metadata.cycle is not None and not 1 <= metadata.cycle <= MAX_CYCLE:
            raise FileRefused(impossible_cycle(metadata.cycle))
        burst = 1 if metadata.burst is None else metadata.burst
        if not 1 <= burst <= MAX_BURST or (burst > 1 and metadata.cycle is None):
            raise FileRefused(f"its burst index {metadata.burst} needs a cycle, and is 1 to {MAX_BURST}")
        label = printable_name(metadata.pose_id[:200]) if changed else None
        return Loaded(found, hashlib.sha256(data).hexdigest(), metadata, pose_id, data, label)

    def known(self, loaded: Loaded) -> Entry | None:
        """Return the entry of an image that the service has at this pose already, written under the file's name."""
        same = self._run.journal.find_image(self._run.session_id, loaded.pose_id, loaded.sha256)
        if same is None:
            return None
        state = "stored" if same.state == "done" and self._run.settings.after != "keep" else same.state
        return self._record(
            replace(same, name=loaded.found.name, signature=loaded.found.signature, state=state)
        )

    def record_present(self, loaded: Loaded) -> Entry:
        """Enter an image that the service says it has, and return its entry."""
        found, cycle = loaded.found, loaded.metadata.cycle
        if cycle is None and self._run.settings.number_cycles:
            cycle = self._numbers.of(loaded.pose_id, loaded.sha256)
        return self._record(Entry(found.name, found.signature, loaded.pose_id, cycle, loaded.sha256, "done"))

    def forget(self, entries: list[Entry]) -> None:
        """Take images for new that the service no longer has; each keeps its cycle. Raises JournalUnusable."""
        for entry in entries:
            if entry.cycle is not None and self._run.settings.number_cycles:
                self._numbers.hold(entry.pose_id, entry.sha256, entry.cycle)
        self._run.journal.forget(self._run.session_id, [entry.name for entry in entries])

    def missing(self, images: list[tuple[str, str]]) -> set[tuple[str, str]]:
        """Return those (pose, SHA-256) that the service has not stored. Raises ClientError."""
        return self._run.client.missing_images(
            self._run.session_id, sorted(set(images)), target_id=self._target_id
        )

    def send(self, loaded: Loaded) -> Entry:
        """Send the commanded pose, if any is new, then the image; return its entry, which is in the journal.

        Raises ClientError, and JournalUnusable where the entry cannot be written.
        """
        metadata = loaded.metadata
        self._send_command(loaded.pose_id, metadata.command, loaded.found.name)
        cycle = metadata.cycle
        if cycle is None and self._run.settings.number_cycles:
            cycle = self._numbers.number(loaded.pose_id, loaded.sha256)
        angles = metadata.joint_angles_deg
        try:
            answer = self._run.client.put_image(
                self._run.session_id,
                loaded.pose_id,
                loaded.sha256,
                loaded.data,
                cycle=cycle,
                burst=metadata.burst,
                target_id=self._target_id,
                focus_group=metadata.focus_group,
                joint_angles_deg=None if angles is None else ",".join(map(repr, angles)),
                captured_at=metadata.captured_at,
                filename=printable_name(loaded.found.name),
                pose_label=loaded.label,
            )
        except ClientError:
            self._numbers.keep(loaded.pose_id, loaded.sha256)
            raise
        entry = Entry(
            loaded.found.name,
            loaded.found.signature,
            loaded.pose_id,
            answer.get("cycle", cycle),
            loaded.sha256,
            "stored" if self._run.settings.needs_results else "done",
            str(answer["id"]),
        )
        return self._record(entry)

    def record_refused(self, loaded: Loaded, error: ClientError) -> Entry:
        """Enter an image that the service does not take as it is, and return its entry."""
        found, cycle = loaded.found, loaded.metadata.cycle
        entry = Entry(
            *(found.name, found.signature, loaded.pose_id, cycle, loaded.sha256, "refused", None, str(error))
        )
        return self._record(entry)

    def send_commands(self) -> None:
        """Send the commanded poses of the table that are new or changed.

        Raises ClientError where the service is away or refuses key or session, and JournalUnusable. Poses that it
        refuses are reported, and hold no image back.
        """
        with self._pose_lock:
            fresh = {}
            for pose_id, command in self.table.commands.items():
                body = json.dumps(command, sort_keys=True)
                if command and body not in (
                    self._known_command(pose_id),
                    self._refused_commands.get(pose_id),
                ):
                    fresh[pose_id] = body
            if fresh and self._put_commands(fresh):
                self._run.report.say(f"{len(fresh)} commanded poses sent")

    def _send_command(self, pose_id: str, command: dict[str, Any], name: str) -> None:
        """Send the commanded pose that an image's own metadata give; the first of a pose applies."""
        if not command:
            return
        with self._pose_lock:
            known = self._known_command(pose_id)
            body = json.dumps(command, sort_keys=True)
            if known is None:
                if body != self._refused_commands.get(pose_id):
                    self._put_commands({pose_id: body})
            elif any(json.loads(known).get(key) != value for key, value in command.items()):
                self._run.report.trouble(
                    "commanded pose",
                    pose_id,
                    f"{name} has another commanded pose than what was sent first, which stays",
                )

    def _known_command(self, pose_id: str) -> str | None:
        return self._run.journal.pose(self._run.session_id, pose_id)

    def _put_commands(self, bodies: dict[str, str]) -> bool:
        """Send commanded poses; return False where the service refuses them, which is reported."""
        poses: list[Json] = [{"pose_id": pose_id, **json.loads(body)} for pose_id, body in bodies.items()]
        try:
            # A table that grows begins with few poses; what looks like another unit in it is reported where it is read.
            self._run.client.put_poses(self._run.session_id, poses, accept_implausible=True)
        except ClientError as error:
            if is_outage(error) or error.status in _OF_KEY_OR_SESSION:
                raise
            self._refused_commands |= bodies
            subject = next(iter(bodies)) if len(bodies) == 1 else f"{len(bodies)} poses"
            advice = f" {error.advice}" if error.advice else ""
            self._run.report.trouble("commanded pose", subject, f"{error}{advice}")
            return False
        for pose_id, body in bodies.items():
            self._run.journal.record_pose(self._run.session_id, pose_id, body)
            self._refused_commands.pop(pose_id, None)
            self._run.report.over("commanded pose", pose_id)
        return True

    def _metadata(self, found: Found) -> ImageMetadata:
        settings = self._run.settings
        tag = tag_of(found.name, settings.matcher)
        pose_id = settings.pose_id or (tag[0] if tag is not None else None)
        cycle, burst = (None, None) if tag is None else tag[1:]
        known = ImageMetadata(
            pose_id,
            counted_from(cycle, settings.first_cycle),
            focus_group=settings.focus_group,
            burst=burst,
        )
        if settings.sidecar == "off":
            return known
        row = self.table.of(found.name)
        sidecar = sidecar_of(found.path)
        if settings.sidecar == "required" and row is None and sidecar is None:
            raise FileNotReady("its sidecar file, or its row in the table of poses, is not there yet")
        if row is not None:
            known = row.over(known)
        if sidecar is not None:
            try:
                known = read_sidecar(sidecar).over(known)
            except MetadataError as error:
                raise FileNotReady(str(error)) from error
        return known

    def _record(self, entry: Entry) -> Entry:
        self._run.journal.record(self._run.session_id, entry)
        self._numbers.release(entry.pose_id, entry.sha256)
        return entry


def _without_identity(signature: str) -> str:
    """Return size and time of a signature: some network file systems number open files otherwise."""
    return signature.rpartition(":")[0]


def printable_name(name: str) -> str | None:
    """Return a file's bare name without what no JSON or address holds."""
    return "".join(c for c in name.rpartition("/")[2] if c.isprintable())[:1000] or None


def _advice(settings: WatchSettings) -> str:
    return "rename it" if settings.matcher is None else "it does not match the pattern"
