"""Thousands of files: what is done for one of them does not grow with their number."""

from __future__ import annotations

import threading
from collections import Counter
from pathlib import Path
from typing import cast

import pytest

from app.client import ServiceClient
from app.client.watch import Journal, Report, Watcher
from tests.support.image.images import small_image
from tests.support.service.instant_service import InstantService
from tests.support.service.watched import watch_settings

FILES = 400


@pytest.mark.parametrize("live", [False, True])
def test_each_file_costs_the_journal_the_same_few_statements(tmp_path: Path, live: bool) -> None:
    images = tmp_path / "images" / "P1"
    images.mkdir(parents=True)
    for number in range(FILES):
        letters = "".join("abcdefghij"[int(digit)] for digit in str(number))  # no number is taken for a cycle
        (images / f"{letters}.png").write_bytes(small_image(number))
    service, journal, done = InstantService(), Journal(tmp_path / "journal.sqlite"), Counter[str]()
    journal._connection.set_trace_callback(lambda statement: done.update([statement.split()[0]]))
    settings = watch_settings(tmp_path / "images", once=True, number_cycles=True, live=live)
    said: list[str] = []
    try:
        watcher = Watcher(cast(ServiceClient, service), journal, Report(said.append, None, {}), settings)
        summary = watcher.run(threading.Event())
        plan = journal._connection.execute(
            "EXPLAIN QUERY PLAN SELECT cycle FROM files WHERE session_id = 's' AND pose_id = 'p' "
            "AND state != 'refused' ORDER BY cycle DESC LIMIT 1"
        ).fetchall()
    finally:
        journal.close()
    assert (summary.stored, summary.waiting) == (FILES, 0), said
    assert set(service.stored.values()) == {1}
    assert len(service.stored) == FILES
    assert done["COMMIT"] <= (2 if live else 1) * FILES + 5, "each is a sync of the disk"
    assert done["SELECT"] <= 3 * FILES + 100
    assert not any("TEMP B-TREE" in step[-1] for step in plan), "the last cycle is not searched for among all"
