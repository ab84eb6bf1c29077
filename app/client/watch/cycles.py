"""Numbers for images without a cycle: each belongs to its image until the service has it."""

from __future__ import annotations

import threading
from collections import defaultdict

from .journal import Journal


class CycleNumbers:
    """Numbers the images of each pose of one session, as they come; safe to use from several threads.

    A number belongs to an image (pose and SHA-256) from its first attempt until it is acknowledged or refused, however
    many attempts that takes. Between runs the journal keeps it, from the first failed attempt on: a row for each image
    that is sent without a failure would cost a second sync of the disk.
    """

    def __init__(self, journal: Journal, session_id: str) -> None:
        self._journal, self._session_id = journal, session_id
        self._lock = threading.Lock()
        self._held: defaultdict[str, dict[str, int]] = defaultdict(dict)
        self._kept: set[tuple[str, str]] = set()
        for pose_id, sha256, cycle in journal.numbers(session_id):
            self._held[pose_id][sha256] = cycle
            self._kept.add((pose_id, sha256))

    def number(self, pose_id: str, sha256: str) -> int:
        """Return the image's number, which is the next one of its pose where it has none. Raises JournalUnusable."""
        with self._lock:
            held = self._held[pose_id]
            if sha256 not in held:
                last = self._journal.last_cycle(self._session_id, pose_id)
                held[sha256] = max((last, *held.values())) + 1
            return held[sha256]

    def of(self, pose_id: str, sha256: str) -> int | None:
        """Return the image's number, None where it has none."""
        with self._lock:
            return self._held[pose_id].get(sha256)

    def keep(self, pose_id: str, sha256: str) -> None:
        """Let the journal keep the image's number, since an attempt has failed. Raises JournalUnusable."""
        with self._lock:
            cycle = self._held[pose_id].get(sha256)
            if cycle is None or (pose_id, sha256) in self._kept:
                return
            self._journal.record_number(self._session_id, pose_id, sha256, cycle)
            self._kept.add((pose_id, sha256))

    def release(self, pose_id: str, sha256: str) -> None:
        """Give the number up once the journal has an entry of the image, which ends its row as well."""
        with self._lock:
            self._held[pose_id].pop(sha256, None)
            self._kept.discard((pose_id, sha256))
