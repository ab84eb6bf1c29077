"""The session that is watched: by its id, or by its name, which may stand for another session later."""

from __future__ import annotations

import threading

from ..http import ClientError, ServiceClient
from ..resources import find_or_make_session
from .gate import Gate, is_outage
from .journal import Journal, JournalUnusable
from .report import Report
from .settings import WatchSettings

_BY_ID = "Give the session's id, which needs no list of sessions, or a key of scope upload."


class CannotBegin(Exception):
    """What is to be watched or where to is wrong, and stays wrong; `advice` is the next action."""

    def __init__(self, detail: str, advice: str | None = None) -> None:
        super().__init__(detail)
        self.advice = advice


class WatchedSession:
    """Finds the session of a run; `id` is that found last."""

    def __init__(
        self, client: ServiceClient, journal: Journal, report: Report, gate: Gate, settings: WatchSettings
    ) -> None:
        self._client, self._journal, self._report, self._gate = client, journal, report, gate
        self._settings = settings
        self.id: str | None = None

    def open(self, stop: threading.Event) -> tuple[str, str | None] | None:
        """Return the ids of session and target once they are known; None where the service never could be asked.

        An id that an earlier run found is taken as it is, unless the service said that it has no such session.

        Raises
        ------
        CannotBegin
            There is no such session, and no target to make it with. A run that had its session waits for another.
        """
        settings, lost = self._settings, self._gate.session_lost
        given = f"{settings.session}\n{settings.target or ''}"
        found = None if lost else self._journal.session(given)
        if found is None and is_id(settings.session) and settings.target is None:
            found = (settings.session, None)  # a key of scope ingest may not read lists
        while found is None:
            if not self._gate.enter(stop) or (
                settings.once and self._gate.failing_for_s > settings.give_up_s
            ):
                return None
            try:
                found = find_or_make_session(self._client, settings.session, settings.target)
                self._gate.session_found()
                self._journal.record_session(given, *found)
            except ClientError as error:
                if not is_outage(error) and (not lost or settings.once):
                    advice = _BY_ID if error.code == "insufficient_scope" else error.advice
                    raise CannotBegin(str(error), advice) from error
                self._gate.failed(error)
                self._report.tick(0)
            except JournalUnusable as error:
                self._gate.leave()
                self._report.trouble("journal", "", f"{error}; tried again")
                stop.wait(settings.poll_s)
        if self.id not in (None, found[0]):
            self._report.say(
                f"the service no longer has session {self.id}; {settings.session} is {found[0]} now, and what it "
                "lacks is sent"
            )
        self.id = found[0]
        self._report.about(session_id=found[0])
        return found


def is_id(session: str) -> bool:
    """Return whether a session was given by its id."""
    return session.startswith("ses_")
