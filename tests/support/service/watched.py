"""A folder that is watched for a session of its own, through a proxy that may fail."""

from __future__ import annotations

import hashlib
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from app.client import ServiceClient
from app.client.images.files import SUFFIXES
from app.client.watch import Journal, Report, Watcher, WatchSettings, WatchSummary
from tests.support.environment.fault_proxy import FaultProxy
from tests.support.service.service import Api

QUICK: dict[str, Any] = {"poll_s": 0.02, "settle_s": 0.05, "longest_pause_s": 0.1, "give_up_s": 60.0}


def watch_settings(folder: Path, **changes: Any) -> WatchSettings:
    """Return the settings of a watch that looks often and waits for little."""
    return WatchSettings(**{"folder": folder, "session": "ses_1", **QUICK, **changes})


@dataclass
class WatchedCell:
    """The folder, what watches it, and what the service has of it."""

    root: Path
    session_id: str
    proxy: FaultProxy
    key: str
    direct: ServiceClient
    lines: list[str] = field(default_factory=list)

    @classmethod
    @contextmanager
    def of(cls, api: Api, root: Path, **board: Any) -> Iterator[WatchedCell]:
        """Make a session of a running application, and a folder for it."""
        url = str(api.client.base_url)
        key = api.client.headers["authorization"].removeprefix("Bearer ")
        session_id = api.make_session(api.make_target(**board))
        with FaultProxy(url) as proxy, ServiceClient(url, key) as direct:
            cell = cls(root, session_id, proxy, key, direct)
            cell.folder.mkdir()
            yield cell

    @property
    def folder(self) -> Path:
        return self.root / "images"

    @property
    def journal(self) -> Path:
        return self.root / "journal.sqlite"

    def write(self, name: str, data: bytes) -> Path:
        """Write a file of the folder at once."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        return path

    def settings(self, **changes: Any) -> WatchSettings:
        return watch_settings(**{"folder": self.folder, "session": self.session_id, **changes})

    def watch(self, stop: threading.Event | None = None, **changes: Any) -> WatchSummary:
        """Watch until nothing is left to do, or until `stop` is set where it is given."""
        journal = Journal(self.journal)
        report = Report(self.lines.append, self.root / "state.json", {})
        settings = self.settings(once=stop is None, **changes)
        try:
            with ServiceClient(self.proxy.url, self.key, retry_for_s=0.0) as client:
                return Watcher(client, journal, report, settings).run(stop or threading.Event())
        finally:
            journal.close()

    @contextmanager
    def watching(self, **changes: Any) -> Iterator[list[WatchSummary]]:
        """Watch in a thread for as long as this context lasts; its summary is there afterwards."""
        stop, ended = threading.Event(), list[WatchSummary]()
        thread = threading.Thread(target=lambda: ended.append(self.watch(stop, **changes)))
        thread.start()
        try:
            yield ended
        finally:
            stop.set()
            thread.join(60.0)
            assert not thread.is_alive()
        assert ended, self.lines

    def measurements(self) -> list[dict[str, Any]]:
        return list(self.direct.items(f"/v1/sessions/{self.session_id}/measurements"))

    def has(self, count: int) -> bool:
        """Return whether the service has this many images."""
        return len(self.measurements()) == count

    def assert_each_image_is_stored_once(self) -> None:
        """Check that every image of the folder is a measurement, once, and was acknowledged to the client once."""
        files = {
            (path.parent.name, hashlib.sha256(path.read_bytes()).hexdigest())
            for path in self.folder.rglob("*")
            if path.suffix in SUFFIXES
        }
        assert Counter((m["pose_id"], m["sha256"]) for m in self.measurements()) == Counter(files)
        repeated = {path: statuses for path, statuses in self.proxy.answered.items() if len(statuses) > 1}
        assert not repeated
