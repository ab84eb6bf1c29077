"""Whether the service may be asked now: after a failure nobody asks for a while, then one does."""

from __future__ import annotations

import threading
import time

from ..http import ClientError
from .report import Report

_FIRST_PAUSE_S = 0.1
"""A lost request holds all others back for as long; on a poor line with many files that is most of the time."""
_AWAY = "service away"
_KEY = "key or session refused"
_NOT_FOUND = 404


class Gate:
    """Holds requests back while the service is away, busy, or refuses the key; safe to use from several threads.

    `by_name`: the session was given by its name, so that another one can take its place (`session_lost`).
    """

    def __init__(self, report: Report, longest_pause_s: float, *, by_name: bool = False) -> None:
        self._report = report
        self._longest_s = longest_pause_s
        self._lock = threading.Condition()
        self._pause_s = 0.0
        self._until = 0.0
        self._failing_since: float | None = None
        self._probing = False
        self._failures = 0
        self._uploads_fail = False
        self._answers_others = False
        self._by_name = by_name
        self._session_lost = False

    def enter(self, stop: threading.Event) -> bool:
        """Wait until a request may be sent; return False where `stop` was set instead.

        While the service fails, one request at a time is let through, after the pause.
        """
        with self._lock:
            while not stop.is_set():
                wait_s = self._until - time.monotonic()
                if wait_s <= 0.0 and not (self._failing_since is not None and self._probing):
                    self._probing = self._failing_since is not None
                    return True
                self._lock.wait(min(0.2, wait_s) if wait_s > 0.0 else 0.2)
        return False

    def leave(self) -> None:
        """Let the next request through, where the service was not reached for another reason than its own."""
        with self._lock:
            self._probing = False
            self._lock.notify_all()

    def passed(self, *, upload: bool = False) -> None:
        """Note that the service has answered, and whether it was an upload.

        Once an upload has failed, only an upload ends the trouble: a service whose disk is full answers all else.
        """
        with self._lock:
            self._probing = False
            if self._uploads_fail and not upload:
                self._answers_others = True
                self._lock.notify_all()
                return
            self._uploads_fail = False
            self._pause_s = self._until = 0.0
            self._failing_since = None
            self._failures = 0
            self._lock.notify_all()
        self._report.over(_AWAY, "", "the service answers again")
        self._report.over(_KEY, "", "the service accepts key and session again")

    def nothing_to_send(self) -> None:
        """Note that no upload is left: other answers end the trouble, too, and one since the last failure does."""
        with self._lock:
            ended = self._uploads_fail and self._answers_others
            self._uploads_fail = False
        if ended:
            self.passed()

    def failed(self, error: ClientError, *, upload: bool = False) -> None:
        """Note that the service, or the way to it, failed, and whether an upload did; a growing pause follows.

        One request that is lost on a poor line is no outage: it is reported from the second failure in a row.
        """
        with self._lock:
            self._probing = False
            lost = self._by_name and (error.status, error.code) == (_NOT_FOUND, "session_not_found")
            self._session_lost |= lost
            self._uploads_fail |= upload and not lost
            self._answers_others = False
            self._failures += 1
            lasting = self._failures > 1
            if self._failing_since is None:
                self._failing_since = time.monotonic()
            self._pause_s = min(self._longest_s, max(_FIRST_PAUSE_S, 2.0 * self._pause_s))
            asked_s = min(error.retry_after_s or 0.0, 15 * self._longest_s)
            self._until = time.monotonic() + max(min(self._pause_s, self._longest_s), asked_s)
            self._lock.notify_all()
        if is_outage(error) and lasting:
            self._report.trouble(
                _AWAY, "", f"the service is away or busy, tried again until it answers: {error}"
            )
        elif not is_outage(error) and not lost:
            advice = f" {error.advice}" if error.advice else ""
            self._report.trouble(
                _KEY, "", f"the service refuses key or session, tried again: {error}{advice}"
            )

    def session_found(self) -> None:
        """Note that the service has answered which session the name stands for."""
        with self._lock:
            self._session_lost = False
        self.passed()

    @property
    def session_lost(self) -> bool:
        """Whether the service has answered that it has no such session, which is then found by its name."""
        with self._lock:
            return self._session_lost

    @property
    def failing_for_s(self) -> float:
        """For how long nothing has come through, 0 where the service answers."""
        with self._lock:
            return 0.0 if self._failing_since is None else time.monotonic() - self._failing_since


_REQUEST_TIMEOUT, _TOO_EARLY, _TOO_MANY, _SERVER_ERROR = 408, 425, 429, 500
_NOT_THIS_IMAGE = frozenset({401, 403, 404, 405})


def is_outage(error: ClientError) -> bool:
    """Return whether an error says nothing of the request: no answer, a busy service, or a proxy's own page."""
    status = error.status
    if status is None:
        return error.code == "unreachable"
    foreign = error.code == "unexpected_answer" and status not in _NOT_THIS_IMAGE
    return foreign or status >= _SERVER_ERROR or status in (_REQUEST_TIMEOUT, _TOO_EARLY, _TOO_MANY)


def concerns_all(error: ClientError) -> bool:
    """Return whether an error would meet every other image, too: an outage, or a refusal of key or session."""
    return is_outage(error) or error.status in _NOT_THIS_IMAGE
