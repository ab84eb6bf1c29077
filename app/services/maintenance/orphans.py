"""Originals that no row names, removed with great reserve.

Deletions record what is to be removed (`services/originals.py`), so that the only orphans there should be are the few
that an upload leaves when the machine dies under it. Where there are more, or no measurement at all is left to name
any, it is the database that is amiss: an empty one was adopted, or an older copy put back. Then nothing is removed.

The grace of an orphan begins when it is first seen as one, and only time during which the service runs counts, so
that neither the age of a file nor a step of the clock shortens it. What was seen is kept in the data folder.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import sqlalchemy as sa

from app.blobs.durable import write_durably
from app.blobs.interface import Blobs
from app.logs import Logger
from app.records.database import Database
from app.records.tables import Measurement, Removal
from app.services.originals import in_pages, remove_unreferenced

GRACE_S = 24 * 3600.0
"""How long a file that no row names is left alone: somebody may be putting files and rows back by hand."""
MAX_STEP_S = 3600.0
"""Most that counts as time between two rounds: a step of the clock, or the time the service was stopped, does not."""
FEW = 10
SMALL_SHARE = 0.01
"""More orphans than `FEW`, and than this share of the originals, are not left by uploads that were interrupted; nor
are more than half of the originals, however few there are."""
STATE = "orphans.json"

log = Logger(__name__)


@dataclass(frozen=True, slots=True)
class _Seen:
    """When orphans were last looked for, and for how long each of them has been known."""

    at_s: float
    known_s: dict[str, float] = field(default_factory=dict)


class OrphanSweep:
    """Removes the orphans of one installation; made once in a process, run every so often."""

    def __init__(self, database: Database, blobs: Blobs, data_dir: Path) -> None:
        self._database = database
        self._blobs = blobs
        self._path = data_dir / STATE
        self._kept = 0

    def run(self, now_s: float, *, stopped: Callable[[], bool] = lambda: False) -> int:
        """Remove what uploads left, and files that have been orphans for the grace; return how many.

        One folder's names are held at a time, and no transaction writes.
        """
        removed = self._blobs.clear_incoming()
        originals, orphans = 0, list[str]()
        for found in self._blobs.names():
            originals += len(found)
            for some in in_pages([sha256 for sha256, _ in found]):
                if stopped():
                    return removed
                orphans += self._orphans(some)
        if not self._credible(len(orphans), originals):
            self._keep(_Seen(now_s))
            return removed
        before = self._read() or _Seen(now_s)
        step_s = min(max(now_s - before.at_s, 0.0), MAX_STEP_S)
        known_s = {
            sha256: before.known_s[sha256] + step_s if sha256 in before.known_s else 0.0 for sha256 in orphans
        }
        due = [sha256 for sha256, age_s in known_s.items() if age_s > GRACE_S]
        swept = remove_unreferenced(self._database, self._blobs, due)
        if swept:
            log.info("orphans_removed", files=len(swept))
        self._keep(_Seen(now_s, {sha256: age_s for sha256, age_s in known_s.items() if sha256 not in swept}))
        return removed + len(swept)

    def _orphans(self, hashes: Sequence[str]) -> list[str]:
        """Return those of `hashes` whose files are there, and that neither a measurement nor a removal names."""
        with self._database.read() as records:
            named = set(records.scalars(sa.select(Measurement.sha256).where(Measurement.sha256.in_(hashes))))
            named |= set(records.scalars(sa.select(Removal.sha256).where(Removal.sha256.in_(hashes))))
        # A removal may have been finished since the names were read.
        return [sha256 for sha256 in hashes if sha256 not in named and self._blobs.is_there(sha256)]

    def _credible(self, orphans: int, originals: int) -> bool:
        """Return whether so many orphans can be what interrupted uploads left; log it once where not."""
        if orphans == 0:
            self._kept = 0
            return True
        with self._database.read() as records:
            is_empty = not records.scalar(sa.select(sa.exists(sa.select(Measurement.id))))
        if not is_empty and orphans <= max(min(FEW, originals // 2), SMALL_SHARE * originals):
            self._kept = 0
            return True
        if orphans != self._kept:
            log.error(
                "orphans_kept",
                files=orphans,
                originals=originals,
                detail="The database names too few of the stored images: it may be empty, or an older copy.",
                advice="Restore the database that belongs to these images. If they are really to go, remove the "
                "files that `gridpose doctor --deep` reports as orphaned.",
            )
        self._kept = orphans
        return False

    def _read(self) -> _Seen | None:
        try:
            stored = json.loads(self._path.read_bytes())
            known_s = {str(sha256): float(age_s) for sha256, age_s in stored["known_s"].items()}
            return _Seen(float(stored["at_s"]), known_s)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            log.warning("orphans_seen_anew", reason="its file cannot be read", path=self._path.name)
            return None

    def _keep(self, seen: _Seen) -> None:
        """Keep what was seen; where that fails, the grace is longer."""
        try:
            if seen.known_s:
                content = json.dumps({"at_s": seen.at_s, "known_s": seen.known_s})
                write_durably(self._path, content.encode("ascii"))
            else:
                self._path.unlink(missing_ok=True)
        except OSError as error:
            log.warning("orphans_not_noted", reason=error.strerror)
