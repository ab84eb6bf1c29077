"""What a watching process says: each trouble once, one line a minute, and a state file for monitoring."""

from __future__ import annotations

import contextlib
import json
import os
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

_EVERY_S = 60.0
_STATE_EVERY_S = 5.0
_LISTED = 100
_SHOWN_OF_A_KIND = 5


@dataclass(frozen=True, slots=True)
class Trouble:
    """Something that hinders a file, or all of them; it is tried again. `since` is RFC 3339."""

    kind: str
    subject: str
    message: str
    since: str


class Report:
    """Counts and troubles of one run; safe to use from several threads.

    Parameters
    ----------
    say
        Prints one line.
    state_file
        Written every few seconds and at the end, whole or not at all; None for none.
    about
        What the state file says in addition: folder, session, journal.
    """

    def __init__(self, say: Callable[[str], None], state_file: Path | None, about: dict[str, Any]) -> None:
        self.counts: Counter[str] = Counter()
        self._say = say
        self._state_file = state_file
        self._about = about
        self._lock = threading.Lock()
        self._troubles: dict[tuple[str, str], Trouble] = {}
        self._shown: Counter[str] = Counter()
        self._line_at = time.monotonic() + _EVERY_S
        self._state_at = 0.0
        self._last = Counter[str]()

    def say(self, line: str) -> None:
        """Print a line."""
        with self._lock:
            self._say(line)

    def about(self, **facts: Any) -> None:
        """Add to what the state file says."""
        with self._lock:
            self._about |= facts

    def count(self, what: str, number: int = 1) -> None:
        """Count what happened."""
        with self._lock:
            self.counts[what] += number

    def trouble(self, kind: str, subject: str, message: str) -> None:
        """Note a trouble; it is printed when it begins, of one kind for the first few subjects."""
        with self._lock:
            known = self._troubles.get((kind, subject))
            since = known.since if known is not None else _now()
            self._troubles[kind, subject] = Trouble(kind, subject, message, since)
            if known is not None:
                return
            self._shown[kind] += 1
            if self._shown[kind] <= _SHOWN_OF_A_KIND:
                self._say(f"{subject}: {message}" if subject else message)
            elif self._shown[kind] == _SHOWN_OF_A_KIND + 1:
                self._say(f"{subject}: {message}; more like this are counted, and listed in the state file")

    def over(self, kind: str, subject: str, message: str = "") -> None:
        """Note that a trouble has ended, if there was one; `message` is then printed."""
        with self._lock:
            if self._troubles.pop((kind, subject), None) is None:
                return
            if not any(known == kind for known, _ in self._troubles):
                del self._shown[kind]
            if message:
                self._say(f"{subject}: {message}" if subject else message)

    def troubles(self, kind: str | None = None) -> list[Trouble]:
        """Return the present troubles, of one kind or all."""
        with self._lock:
            return [one for one in self._troubles.values() if kind in (None, one.kind)]

    def has(self, kind: str, subject: str) -> bool:
        """Return whether there is this trouble."""
        with self._lock:
            return (kind, subject) in self._troubles

    def tick(self, waiting: int, *, last: bool = False) -> None:
        """Print the line of a minute and write the state file, where they are due."""
        now = time.monotonic()
        if now >= self._line_at or last:
            self._line_at = now + _EVERY_S
            self.say(self._line(waiting))
        if self._state_file is not None and (now >= self._state_at or last):
            self._state_at = now + _STATE_EVERY_S
            self._write(self._state_file, waiting, running=not last)

    def _line(self, waiting: int) -> str:
        with self._lock:
            parts = [f"{self.counts['stored']} stored"]
            if fresh := self.counts["stored"] - self._last["stored"]:
                parts[0] += f" (+{fresh})"
            self._last = Counter(self.counts)
            shown = {"present": "already there", "measured": "measured", "failed": "failed"}
            parts += [f"{self.counts[what]} {words}" for what, words in shown.items() if self.counts[what]]
            parts.append(f"{waiting} waiting")
            kinds = Counter(kind for kind, _ in self._troubles)
            parts += [f"{kind}: {count}" if count > 1 else kind for kind, count in sorted(kinds.items())]
        return ", ".join(parts)

    def _write(self, path: Path, waiting: int, *, running: bool) -> None:
        with self._lock:
            troubles = list(self._troubles.values())
            content = {
                **self._about,
                "running": running,
                "process_id": os.getpid(),
                "updated_at": _now(),
                "waiting": waiting,
                **{
                    what: self.counts[what] for what in ("stored", "present", "refused", "measured", "failed")
                },
                "trouble_count": len(troubles),
                "troubles": [
                    {"kind": t.kind, "subject": t.subject, "message": t.message, "since": t.since}
                    for t in troubles[:_LISTED]
                ],
            }
        fresh = path.with_name(f"{path.name}.new")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            fresh.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
            fresh.replace(path)
        except PermissionError:  # on Windows while somebody reads it; the next time is soon
            with contextlib.suppress(OSError):
                fresh.unlink()
            self.trouble("state file", str(path), "it cannot be replaced; tried again")
        except OSError as error:
            self.trouble("state file", str(path), f"it cannot be written: {error.strerror}; tried again")
        else:
            self.over("state file", str(path), "it can be written again")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
