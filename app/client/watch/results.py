"""Results of stored images: printed, handed to a command, and acted on by moving or deleting the file."""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import shutil
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

from ..http import ClientError, Json
from ..summary import is_measured
from .delivery import SessionRun
from .files import signature_of
from .gate import Gate, concerns_all
from .journal import Entry, State
from .live import BURST_ADVICE, NextViewLine, describe_result, is_of_burst, wants_bursts

_ROUND = 50
_UNFINISHED_IN_A_ROUND = 4
_GONE = 404
_NOT_ALLOWED = (401, 403)


class Results:
    """Follows the images of one session whose results are wanted; used by one thread."""

    def __init__(self, run: SessionRun, on_failed: Callable[[], None]) -> None:
        self._run = run
        self._on_failed = on_failed
        self._said_bursts = False
        self._news = False
        purpose = run.settings.next_view
        self.next_view = None if purpose is None else NextViewLine(run, purpose)

    def pending(self) -> bool:
        """Return whether a stored image has no result, or one that was not acted on, or the next view is not known."""
        if self.next_view is not None and (self._news or self.next_view.is_pending()):
            return True
        return self._run.journal.has_state(self._run.session_id, "stored", "measured", "failed")

    def follow(self, gate: Gate, stop: threading.Event) -> None:
        """Ask for results, the oldest first, and act on them. Raises JournalUnusable."""
        unfinished = 0
        for entry in self._run.journal.in_state(self._run.session_id, "stored", most=_ROUND):
            if unfinished >= _UNFINISHED_IN_A_ROUND or not gate.enter(stop):
                break
            try:
                measurement = self._run.client.get(f"/v1/measurements/{entry.measurement_id}")
            except ClientError as error:
                if error.status == _GONE:
                    gate.passed()
                    self._finish(entry, "done", "its measurement was deleted in the service")
                elif error.status in _NOT_ALLOWED:
                    gate.passed()
                    self._run.report.trouble(
                        "results",
                        "",
                        f"results cannot be read: {error} Sending goes on; results need a key of scope upload or read.",
                    )
                    return
                elif concerns_all(error):
                    gate.failed(error)
                    break
                else:
                    gate.passed()
                    self._run.report.trouble("results", entry.name, str(error))
                continue
            gate.passed()
            self._run.report.over("results", "")
            if measurement["status"] not in ("succeeded", "failed"):
                unfinished += 1
                continue
            self._take(entry, measurement)
        if self._news and self.next_view is not None:
            self.next_view.want()
        self._news = False
        for entry in self._run.journal.in_state(self._run.session_id, "measured", "failed"):
            self._settle(entry)

    def _take(self, entry: Entry, measurement: Json) -> None:
        """Print a result and hand it to the user's command, then enter it in the journal: at least once."""
        good = is_measured(measurement)
        if self._run.settings.live:
            self._run.report.say(describe_result(entry.name, measurement))
            if not self._said_bursts and wants_bursts(measurement):
                self._said_bursts = True
                self._run.report.say(BURST_ADVICE)
            self._said_bursts |= is_of_burst(measurement)
        if self._run.settings.on_result is not None:
            self._run_command(self._run.settings.on_result, entry, measurement)
        self._run.report.count("measured" if good else "failed")
        if not good:
            self._on_failed()
        self._news |= good
        failure = measurement["failure"] or {}
        state: State = "measured" if good else "failed"
        if self._run.settings.after == "keep":
            state = "done"
        self._finish(entry, state, None if good else failure.get("code"))

    def _run_command(self, command: str, entry: Entry, measurement: Json) -> None:
        path = self._run.settings.folder / entry.name
        body = json.dumps({"file": str(path), "measurement": measurement}, allow_nan=False)
        words = command if os.name == "nt" else shlex.split(command)  # Windows splits the line itself
        trouble = None
        try:
            ended = subprocess.run(  # noqa: S603 - the user's own command, without a shell
                words,
                input=body.encode(),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                timeout=self._run.settings.on_result_within_s,
                check=False,
            )
            if ended.returncode:
                said = ended.stderr.decode(errors="replace").strip().splitlines()
                trouble = f"it ended with {ended.returncode}" + (f": {said[-1]}" if said else "")
        except subprocess.TimeoutExpired:
            trouble = f"it did not end within {self._run.settings.on_result_within_s:g} s"
        except OSError as error:
            trouble = f"it cannot be run: {error.strerror}"
        if trouble is None:
            self._run.report.over("--on-result", command, "it works again")
        else:
            self._run.report.trouble("--on-result", command, f"{trouble} ({entry.name})")

    def _settle(self, entry: Entry) -> None:
        """Move or delete the file of a result, if it is still the one that was sent."""
        settings = self._run.settings
        path = settings.folder / entry.name
        try:
            if settings.after == "move" and settings.moved_to is not None:
                place = settings.moved_to if entry.state == "measured" else settings.moved_to / "not-measured"
                _move(path, place / entry.name, entry)
            elif settings.after == "delete" and entry.state == "measured" and _is_the_one(path, entry):
                path.unlink()
        except OSError as error:
            what = "moved" if settings.after == "move" else "deleted"
            self._run.report.trouble(
                f"not {what}", entry.name, f"it cannot be {what}: {error.strerror or error}; tried again"
            )
            return
        for kind in ("not moved", "not deleted"):
            self._run.report.over(kind, entry.name)
        self._finish(entry, "done", entry.detail)

    def _finish(self, entry: Entry, state: State, detail: str | None) -> None:
        self._run.journal.advance(self._run.session_id, entry, state, detail)


def _is_the_one(path: Path, entry: Entry) -> bool:
    """Return whether a file is there and is the one that was sent."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return False
    if signature_of(status) == entry.signature:
        return True
    return _sha256_of(path) == entry.sha256


def _move(path: Path, destination: Path, entry: Entry) -> None:
    """Move a file that was sent; repeated after a power cut between copy and deletion, it does the rest."""
    if not _is_the_one(path, entry):
        return
    destination.parent.mkdir(parents=True, exist_ok=True)
    number = 1
    while destination.exists() and _sha256_of(destination) != entry.sha256:
        number += 1
        destination = destination.with_name(f"{path.stem}-{number}{path.suffix}")
    if destination.exists():
        path.unlink()
        return
    try:
        path.rename(destination)
    except OSError:
        # Not longer than names may be, whatever the file's.
        partial = destination.with_name(f".{entry.sha256}.part")
        shutil.copy2(path, partial)
        with partial.open("rb+") as stream:
            os.fsync(stream.fileno())
        partial.replace(destination)
        path.unlink()


def _sha256_of(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
