"""Advice on the next view, which takes the service long: results do not wait for it."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any, cast

from app.client import ClientError, ServiceClient
from app.client.watch import Journal, Report, Watcher, WatchSummary
from tests.support.image.images import small_image
from tests.support.service.instant_service import InstantService
from tests.support.service.service import wait_until
from tests.support.service.watched import watch_settings


class SlowAdvice(InstantService):
    """A service whose next view is answered once `release` is set."""

    def __init__(self) -> None:
        super().__init__()
        self.release = threading.Event()
        self.asked = 0

    def create(self, path: str, body: dict[str, Any]) -> dict[str, Any]:
        self.asked += 1
        assert self.release.wait(60.0)
        if self.asked > 1:
            raise ClientError("unreachable", "The service does not answer.")
        return {"suggestions": [{"instruction": f"view {self.asked}"}]}


def test_results_do_not_wait_for_the_next_view(tmp_path: Path) -> None:
    images = tmp_path / "images" / "P1"
    images.mkdir(parents=True)
    settings = watch_settings(tmp_path / "images", live=True, next_view="intrinsics")
    said: list[str] = []
    ended: list[WatchSummary] = []
    service, journal = SlowAdvice(), Journal(tmp_path / "journal.sqlite")
    watcher = Watcher(cast(ServiceClient, service), journal, Report(said.append, None, {}), settings)
    stop = threading.Event()
    thread = threading.Thread(target=lambda: ended.append(watcher.run(stop)))

    def shown() -> int:
        return sum("found" in line for line in said)

    (images / "1.png").write_bytes(small_image(1))
    thread.start()
    wait_until(lambda: service.asked == 1, 120, "the next view is asked for")
    for number in range(2, 6):
        (images / f"{number}.png").write_bytes(small_image(number))
    wait_until(lambda: shown() == 5, 120, "results are printed while the answer is awaited")
    assert service.asked == 1
    service.release.set()
    wait_until(lambda: service.asked == 2, 120, "the next view is asked for again")
    stop.set()
    thread.join(30.0)
    journal.close()
    assert ended[0].measured == 5
    assert service.asked == 2, "asked once for all results that came meanwhile"
    assert [line for line in said if line.startswith("next: ")] == ["next: view 1"]
    assert any("next view cannot be asked for" in line for line in said)
