"""Files that wait to be sent, and the threads that send them; a file that cannot be sent now is tried again."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass

from ..http import ClientError
from .delivery import Delivery, FileNotReady, FileRefused, Loaded
from .files import Found, in_natural_order
from .gate import Gate, concerns_all
from .journal import Entry, JournalUnusable
from .report import Report
from .settings import WatchSettings

_RETRY_S = (2.0, 300.0)
_INCOMPLETE_AFTER_S = 60.0
_ASKED_AT_ONCE = 200
_INTERNAL_ERROR = 500
_OF_FILES = ("file", "not whole", "refused")


@dataclass(slots=True)
class _Pause:
    until: float
    length_s: float


class Sending:
    """The files of one session between the folder and the service; safe to use from several threads.

    `known` holds the signature of each file that the journal has.
    """

    def __init__(
        self, delivery: Delivery, gate: Gate, report: Report, settings: WatchSettings, known: dict[str, str]
    ) -> None:
        self._delivery, self._gate, self._report, self._settings = delivery, gate, report, settings
        self._queue: queue.SimpleQueue[list[Found]] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._known = known
        self._in_flight: set[str] = set()
        self._pauses: dict[str, _Pause] = {}
        self._not_whole_since: dict[str, float] = {}
        self._ask_first: set[str] = set()

    def fresh(self, images: list[Found], *, whole_listing: bool) -> list[Found]:
        """Return the images that the journal does not have as they are; forget what is gone, if all was listed."""
        with self._lock:
            found = [image for image in images if self._known.get(image.name) != image.signature]
            if whole_listing:  # what is gone is the journal's to remember
                present = {image.name for image in images}
                self._known = {name: known for name, known in self._known.items() if name in present}
        return found

    def ask_first(self, names: Iterable[str]) -> None:
        """Ask the service whether it has these files before they are sent: an earlier run may have sent them."""
        with self._lock:
            self._ask_first |= set(names)

    def forget(self, names: Iterable[str]) -> None:
        """Take files for new."""
        with self._lock:
            for name in names:
                self._known.pop(name, None)

    def tidy(self, present: set[str], fresh: set[str]) -> None:
        """Forget troubles of files that are gone, and pauses of those that are done."""
        for kind in _OF_FILES:
            for trouble in self._report.troubles(kind):
                if trouble.subject not in present:
                    self._report.over(kind, trouble.subject)
        with self._lock:
            self._pauses = {name: pause for name, pause in self._pauses.items() if name in fresh}
            self._not_whole_since = {n: since for n, since in self._not_whole_since.items() if n in fresh}
            self._ask_first &= fresh

    def offer(self, complete: Iterable[Found]) -> None:
        """Queue the files that are not under way and may be tried."""
        now = time.monotonic()
        with self._lock:
            ready = in_natural_order(
                found
                for found in complete
                if found.name not in self._in_flight
                and (found.name not in self._pauses or now >= self._pauses[found.name].until)
            )
            self._in_flight |= {found.name for found in ready}
            asked = [found for found in ready if found.name in self._ask_first]
            batches = [asked[i : i + _ASKED_AT_ONCE] for i in range(0, len(asked), _ASKED_AT_ONCE)]
            batches += [[found] for found in ready if found.name not in self._ask_first]
        for batch in batches:
            self._queue.put(batch)

    def offer_commands(self) -> None:
        """Queue the commanded poses of the table."""
        self._queue.put([])

    def is_idle(self, waiting: int) -> bool:
        """Return whether nothing is under way and each of the waiting files was tried again in vain."""
        with self._lock:
            tried = [pause for pause in self._pauses.values() if pause.length_s > _RETRY_S[0]]
            return not self._in_flight and self._queue.empty() and len(tried) >= waiting

    def work(self, ended: threading.Event) -> None:
        """Send what is queued until `ended` is set."""
        while not ended.is_set():
            try:
                batch = self._queue.get(timeout=0.2)
            except queue.Empty:
                continue
            if not batch:
                self._send_commands(ended)
            else:
                with self._lock:
                    asked = batch[0].name in self._ask_first
                for found in self._not_there_yet(batch, ended) if asked else batch:
                    self._send(found, ended)

    def _send_commands(self, ended: threading.Event) -> None:
        if not self._gate.enter(ended):
            return
        try:
            self._delivery.send_commands()
            self._gate.passed()
        except ClientError as error:
            self._gate.failed(error)
            ended.wait(_RETRY_S[0])
            self.offer_commands()
        except JournalUnusable as error:
            self._gate.leave()
            self._journal_failed(error, ended)
            self.offer_commands()

    def _not_there_yet(self, batch: list[Found], ended: threading.Event) -> list[Found]:
        """Enter those files in the journal that the service has; return the others, which stay under way."""
        images: dict[str, tuple[str, str]] = {}
        for found in batch:
            if not ended.is_set() and (loaded := self._load(found)) is not None:
                images[found.name] = (loaded.pose_id, loaded.sha256)
        rest = [found for found in batch if found.name in images]
        try:
            if not rest or not self._gate.enter(ended):
                return self._put_off(batch)
            missing = self._delivery.missing(list(images.values()))
        except ClientError as error:
            self._gate.failed(error)
            return self._put_off(batch)
        self._gate.passed()
        self._put_off([found for found in batch if found.name not in images])
        with self._lock:
            self._ask_first -= set(images)
        if self._settings.needs_results:
            return rest  # an image that is there is sent once more, since the answer has its measurement's id
        for found in rest:
            if images[found.name] not in missing:
                self._enter_present(found, images[found.name], ended)
        return [found for found in rest if images[found.name] in missing]

    def _enter_present(self, found: Found, image: tuple[str, str], ended: threading.Event) -> None:
        try:
            loaded = self._load(found)
            if loaded is not None and (loaded.pose_id, loaded.sha256) == image:
                self._enter(self._delivery.record_present(loaded), "present")
        except JournalUnusable as error:
            self._journal_failed(error, ended)
        finally:
            self._put_off([found])

    def _load(self, found: Found) -> Loaded | None:
        """Read a file; None, with the trouble noted, where it cannot be sent now."""
        name = found.name
        try:
            loaded = self._delivery.load(found)
        except FileNotReady as error:
            self._pause(name)
            with self._lock:
                since = self._not_whole_since.setdefault(name, time.monotonic())
            if self._settings.once or time.monotonic() - since >= _INCOMPLETE_AFTER_S:
                self._report.trouble("not whole", name, f"{error}; tried again")
        except FileRefused as error:
            self._pause(name, longest=True)
            self._report.trouble("refused", name, str(error))
        except FileNotFoundError:
            pass  # it was moved or deleted meanwhile
        except OSError as error:
            self._pause(name)
            self._report.trouble("file", name, f"it cannot be read: {error.strerror or error}; tried again")
        else:
            self._report.over("file", name, "it can be read again")
            self._report.over("not whole", name, "it is whole now")
            return loaded
        return None

    def _send(self, found: Found, ended: threading.Event) -> None:
        """Send one file; whatever hinders it is noted, and the file tried again later."""
        name = found.name
        try:
            if ended.is_set() or (loaded := self._load(found)) is None:
                return
            entry = self._delivery.known(loaded)
            if entry is not None:
                self._enter(entry, "present")
            elif self._gate.enter(ended):
                self._send_loaded(loaded)
        except JournalUnusable as error:
            self._gate.leave()
            self.ask_first([name])
            self._journal_failed(error, ended)
        finally:
            self._put_off([found])

    def _send_loaded(self, loaded: Loaded) -> None:
        name = loaded.found.name
        try:
            self._delivery.send_commands()
            entry = self._delivery.send(loaded)
        except ClientError as error:
            if concerns_all(error):
                if error.status == _INTERNAL_ERROR:
                    self._pause(name)  # it may be of this image: others go first
                self.ask_first([name])  # the answer may have been lost on its way back
                self._gate.failed(error, upload=error.status != _INTERNAL_ERROR)
                return
            self._gate.passed(upload=True)
            self._enter(self._delivery.record_refused(loaded, error), "refused")
            advice = f" {error.advice}" if error.advice else ""
            self._report.trouble("refused", name, f"{error}{advice}")
        else:
            self._gate.passed(upload=True)
            self._enter(entry, "stored")

    def _enter(self, entry: Entry, counted_as: str) -> None:
        """Take what the journal has of a file now; it is not looked at again until it changes."""
        self._report.count(counted_as)
        self._report.over("journal", "", "the journal can be written again")
        if counted_as != "refused":
            self._report.over("refused", entry.name)
        with self._lock:
            self._known[entry.name] = entry.signature
            self._pauses.pop(entry.name, None)

    def _journal_failed(self, error: JournalUnusable, ended: threading.Event) -> None:
        self._report.trouble("journal", "", f"{error}; tried again, nothing is sent meanwhile")
        ended.wait(_RETRY_S[0])

    def _pause(self, name: str, *, longest: bool = False) -> None:
        """Leave a file alone for a while, each time for longer."""
        with self._lock:
            known = self._pauses.get(name)
            length_s = _RETRY_S[1] if longest else _RETRY_S[0]
            if known is not None and not longest:
                length_s = min(_RETRY_S[1], 2.0 * known.length_s)
            self._pauses[name] = _Pause(time.monotonic() + length_s, length_s)

    def _put_off(self, batch: list[Found]) -> list[Found]:
        """End the way of files for now; the next look at the folder queues those again that are not done."""
        with self._lock:
            self._in_flight -= {found.name for found in batch}
        return []
