"""Watch a folder: look, wait until files are complete, send, follow results; for months, whatever happens meanwhile."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ..http import ClientError, ServiceClient
from .delivery import Delivery, SessionRun
from .files import TABLE, PoseTable, Settling, list_folder, read_table, signature_of
from .gate import Gate, concerns_all
from .journal import Entry, Journal, JournalUnusable
from .report import Report
from .results import Results
from .sending import Sending
from .session import WatchedSession, is_id
from .settings import WatchSettings

_SHARE_OF_TIME = 10.0
_END_WITHIN_S = 10.0
_VERIFY_EVERY_S = 86_400.0
_JOURNAL_AGAIN_S = 2.0
_FOLDER = "folder"


@dataclass(frozen=True, slots=True)
class WatchSummary:
    """How a run ended: numbers of images stored, measured and not measured, and what is left to do."""

    session_id: str | None
    stored: int
    measured: int
    failed: int
    refused: int
    waiting: int
    gave_up: bool


class Watcher:
    """Watches one folder for one session.

    Parameters
    ----------
    client
        Of the service; requests are sent once each (`retry_for_s=0`), since the watcher repeats them itself.
    journal, report
        This run's.
    settings
        See there.
    on_failed
        Called for each image that gave no measurement.
    """

    def __init__(
        self,
        client: ServiceClient,
        journal: Journal,
        report: Report,
        settings: WatchSettings,
        *,
        on_failed: Callable[[], None] = lambda: None,
    ) -> None:
        self._client, self._journal, self._report, self._settings = client, journal, report, settings
        self._on_failed = on_failed
        self._gate = Gate(report, settings.longest_pause_s, by_name=not is_id(settings.session))
        self._session = WatchedSession(client, journal, report, self._gate, settings)
        self._settling = Settling(settings.settle_s if settings.complete == "settled" else 0.0)
        self._table_signature = ""
        self._verify_at = 0.0
        self._crash: BaseException | None = None
        self._waiting = 0

    def run(self, stop: threading.Event) -> WatchSummary:
        """Watch until `stop` is set or, with `once`, until nothing is left to do.

        Raises
        ------
        CannotBegin
            There is no such session, and no target to make it with.
        """
        gave_up = self._run_session(stop)
        while self._gate.session_lost and not gave_up and not stop.is_set():
            self._verify_at, self._table_signature = 0.0, ""  # of the session that takes its place
            gave_up = self._run_session(stop)
        self._report.tick(self._waiting, last=True)
        counts = self._report.counts
        return WatchSummary(
            session_id=self._session.id,
            stored=counts["stored"],
            measured=counts["measured"],
            failed=counts["failed"],
            refused=counts["refused"],
            waiting=self._waiting,
            gave_up=gave_up and not stop.is_set(),
        )

    def _run_session(self, stop: threading.Event) -> bool:
        """Watch for as long as the service has the session; return whether that ended because it stayed away."""
        session = self._session.open(stop)
        return session is None or self._watch(_Work.of(self, *session), stop)

    def _watch(self, work: _Work, stop: threading.Event) -> bool:
        """Return whether watching ended because the service stayed away."""
        ended = threading.Event()
        tasks = [work.sending.work] * self._settings.parallel
        if self._settings.needs_results:
            tasks.append(partial(self._follow_results, work))
        if work.results.next_view is not None:
            tasks.append(work.results.next_view.work)
        threads = [threading.Thread(target=self._guarded, args=(task, ended), daemon=True) for task in tasks]
        for thread in threads:
            thread.start()
        gave_up, first = False, True
        try:
            while not stop.is_set() and not self._gate.session_lost:
                began = time.monotonic()
                self._look(work, first=first)
                first = False
                self._report.tick(self._waiting)
                if self._crash is not None:
                    raise self._crash  # better to end, and be started again, than to watch without sending
                if self._settings.once:
                    gave_up = self._gate.failing_for_s > self._settings.give_up_s
                    if gave_up or self._is_idle(work):
                        break
                # A large folder on a slow share is not looked through all the time.
                stop.wait(max(self._settings.poll_s, _SHARE_OF_TIME * (time.monotonic() - began)))
        finally:
            ended.set()
            deadline = time.monotonic() + _END_WITHIN_S
            for thread in threads:
                thread.join(max(0.0, deadline - time.monotonic()))
        return gave_up

    def _guarded(self, work: Callable[[threading.Event], None], ended: threading.Event) -> None:
        try:
            work(ended)
        except BaseException as error:  # noqa: BLE001 - raised by the main thread
            self._crash = error

    def _look(self, work: _Work, *, first: bool) -> None:
        """List the folder and queue what is complete and not yet sent."""
        settings, sending = self._settings, work.sending
        marker = settings.marker if settings.complete == "marker" else None
        listing = list_folder(settings.folder, excluded=settings.moved_to, marker=marker)
        self._note_unreadable(listing.unreadable)
        if settings.sidecar != "off":
            self._read_table(work)
        present = {found.name for found in listing.images}
        if time.monotonic() >= self._verify_at and not self._gate.failing_for_s:
            self._verify(work, present)
        fresh = sending.fresh(listing.images, whole_listing=not listing.unreadable)
        if marker is not None:
            fresh = [f for f in fresh if {f.name, f.name.rpartition(".")[0]} & listing.markers]
        sending.tidy(present, {found.name for found in fresh})
        if first:
            sending.ask_first(found.name for found in fresh)
        self._waiting = len(fresh)
        if not fresh:
            self._gate.nothing_to_send()
        sending.offer(self._settling.still(fresh))

    def _note_unreadable(self, unreadable: dict[str, str]) -> None:
        for name, reason in unreadable.items():
            subject = str(self._settings.folder) if name == "." else name
            self._report.trouble(_FOLDER, subject, f"it cannot be read: {reason}; tried again")
        still = {str(self._settings.folder) if name == "." else name for name in unreadable}
        for trouble in self._report.troubles(_FOLDER):
            if trouble.subject not in still:
                self._report.over(_FOLDER, trouble.subject, "it can be read again")

    def _verify(self, work: _Work, present: set[str]) -> None:
        """Ask whether the service still has what the journal says: one restored from a backup may not."""
        entries = [
            entry
            for name, entry in self._journal.entries(work.session_id).items()
            if name in present and entry.state != "refused"
        ]
        lost: list[Entry] = []
        try:
            for start in range(
                0, max(len(entries), 1), 1000
            ):  # of no images, too: are key and session accepted?
                part = entries[start : start + 1000]
                missing = work.delivery.missing([(e.pose_id, e.sha256) for e in part])
                lost += [e for e in part if (e.pose_id, e.sha256) in missing]
        except ClientError as error:
            if concerns_all(error):
                self._gate.failed(error)
                return
            self._report.trouble("verification", "", f"the service does not say which images it has: {error}")
        self._verify_at = time.monotonic() + _VERIFY_EVERY_S
        if lost:
            self._report.say(
                f"the service no longer has {len(lost)} images that it had; they are sent again. To keep an image out, "
                "exclude its measurement in place of deleting it, or move its file away"
            )
            work.delivery.forget(lost)
            work.sending.forget(entry.name for entry in lost)
        self._journal.prune(work.session_id, present)

    def _read_table(self, work: _Work) -> None:
        """Read the table of poses where it has changed, and send its commanded poses."""
        path = self._settings.table or self._settings.folder / TABLE
        try:
            signature = signature_of(path.stat())
            if signature == self._table_signature:
                return
            table = read_table(path)
        except FileNotFoundError:
            work.delivery.table = PoseTable()
            self._table_signature = ""
            return
        except OSError as error:
            self._report.trouble("table", path.name, f"it cannot be read: {error.strerror}; tried again")
            return
        work.delivery.table = table
        self._table_signature = signature
        for trouble in self._report.troubles("table"):
            self._report.over("table", trouble.subject)
        for subject, _, message in (error.partition(": ") for error in table.errors):
            self._report.trouble("table", subject, message)
        if table.commands:
            work.sending.offer_commands()

    def _is_idle(self, work: _Work) -> bool:
        """Return whether nothing is left to do that this program can do."""
        if self._gate.failing_for_s or not work.sending.is_idle(self._waiting):
            return False
        awaited = self._settings.needs_results and not self._report.has("results", "")
        return not (awaited and work.results.pending())

    def _follow_results(self, work: _Work, ended: threading.Event) -> None:
        while not ended.is_set():
            try:
                work.results.follow(self._gate, ended)
            except JournalUnusable as error:
                self._gate.leave()
                self._report.trouble("journal", "", f"{error}; tried again")
                ended.wait(_JOURNAL_AGAIN_S)
            ended.wait(min(0.5, self._settings.poll_s))


@dataclass(frozen=True, slots=True)
class _Work:
    """What is done for one session, once its id is known."""

    session_id: str
    delivery: Delivery
    sending: Sending
    results: Results

    @classmethod
    def of(cls, watcher: Watcher, session_id: str, target_id: str | None) -> _Work:
        run = SessionRun(watcher._client, watcher._journal, watcher._report, watcher._settings, session_id)
        # What was refused is tried once more at each start: the session may have been corrected.
        entries = run.journal.entries(session_id).values()
        known = {entry.name: entry.signature for entry in entries if entry.state != "refused"}
        delivery = Delivery(run, target_id)
        return cls(
            session_id,
            delivery,
            Sending(delivery, watcher._gate, run.report, run.settings, known),
            Results(run, watcher._on_failed),
        )
