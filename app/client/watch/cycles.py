"""Numbers for images without a cycle: each belongs to its image until the service has it."""

from __future__ import annotations

import threading
from collections import defaultdict

from ..http import ClientError, ServiceClient
from .journal import Journal
from .report import Report

_NOT_ALLOWED = 403
_BLIND = (
    "the key may not read which cycles the session has: --number-cycles gives a number twice if the journal was lost, "
    "or if others send images of the same pose. Use a key of scope upload, or state cycles in the files' names."
)


class CycleNumbers:
    """Numbers the images of each pose of one session, as they come; safe to use from several threads.

    A number belongs to an image (pose and SHA-256) from its first attempt until it is acknowledged or refused, however
    many attempts that takes. Between runs the journal keeps it, from the first failed attempt on: a row for each image
    that is sent without a failure would cost a second sync of the disk. Which cycles the service has of a pose is asked
    once a run: the journal may be newer than the session.
    """

    def __init__(self, client: ServiceClient, journal: Journal, report: Report, session_id: str) -> None:
        self._client, self._journal, self._report = client, journal, report
        self._session_id = session_id
        self._stored: dict[str, dict[str, int]] = {}
        self._may_read, self._said = True, False
        self._lock = threading.Lock()
        self._held: defaultdict[str, dict[str, int]] = defaultdict(dict)
        self._kept: set[tuple[str, str]] = set()
        for pose_id, sha256, cycle in journal.numbers(session_id):
            self._held[pose_id][sha256] = cycle
            self._kept.add((pose_id, sha256))

    def number(self, pose_id: str, sha256: str) -> int:
        """Return the image's number, which is the next one of its pose where it has none.

        Raises ClientError where the service does not answer, and JournalUnusable.
        """
        with self._lock:
            held = self._held[pose_id]
            if sha256 not in held:
                last = self._journal.last_cycle(self._session_id, pose_id)
                stored = self._stored_of(pose_id, blind=last == 0)
                held[sha256] = stored.get(sha256) or max((last, *stored.values(), *held.values())) + 1
            return held[sha256]

    def of(self, pose_id: str, sha256: str) -> int | None:
        """Return the image's number here or in the service, None where it has none or cannot be asked for."""
        with self._lock:
            held = self._held[pose_id].get(sha256)
            if held is not None:
                return held
            try:
                return self._stored_of(pose_id, blind=False).get(sha256)
            except ClientError:
                return None

    def keep(self, pose_id: str, sha256: str) -> None:
        """Let the journal keep the image's number, since an attempt has failed. Raises JournalUnusable."""
        with self._lock:
            cycle = self._held[pose_id].get(sha256)
            if cycle is None or (pose_id, sha256) in self._kept:
                return
            self._journal.record_number(self._session_id, pose_id, sha256, cycle)
            self._kept.add((pose_id, sha256))

    def hold(self, pose_id: str, sha256: str, cycle: int) -> None:
        """Give an image the number that it had, since it is to be sent again. Raises JournalUnusable."""
        with self._lock:
            self._journal.record_number(self._session_id, pose_id, sha256, cycle)
            self._held[pose_id][sha256] = cycle
            self._kept.add((pose_id, sha256))

    def release(self, pose_id: str, sha256: str) -> None:
        """Give the number up once the journal has an entry of the image, which ends its row as well."""
        with self._lock:
            self._held[pose_id].pop(sha256, None)
            self._kept.discard((pose_id, sha256))

    def _stored_of(self, pose_id: str, *, blind: bool) -> dict[str, int]:
        """Return the cycle of each image that the service had of a pose when it was asked first.

        A key that may not read gets none, which is said once where nothing else is known (`blind`).
        """
        if pose_id not in self._stored and self._may_read:
            path = f"/v1/sessions/{self._session_id}/measurements"
            try:
                found = list(self._client.items(path, pose_id=pose_id))
            except ClientError as error:
                if error.status != _NOT_ALLOWED:
                    raise
                self._may_read = False
            else:
                self._stored[pose_id] = {m["sha256"]: m["cycle"] for m in found if m["cycle"] is not None}
        if blind and not self._may_read and not self._said:
            self._said = True
            self._report.say(_BLIND)
        return self._stored.get(pose_id, {})
