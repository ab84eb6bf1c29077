"""When requests are held back, and what ends that."""

from __future__ import annotations

from collections import Counter

import pytest

from app.client import ClientError
from app.client.watch import Report
from app.client.watch.gate import Gate
from tests.support.environment.fault_proxy import Fault
from tests.support.image.images import small_image
from tests.support.service.service import wait_until
from tests.support.service.watched import WatchedCell

FULL = ClientError("storage_full", "The disk is full.", status=507)


def failing_gate(lines: list[str]) -> Gate:
    gate = Gate(Report(lines.append, None, {}), 60.0)
    for _ in range(3):
        gate.passed()
        gate.failed(FULL, upload=True)
    assert gate.failing_for_s > 0.0
    return gate


def test_what_is_cheap_ends_no_trouble_of_uploads() -> None:
    lines: list[str] = []
    gate = failing_gate(lines)
    assert gate._pause_s == pytest.approx(0.4), "it grows"
    assert [("away" in line) for line in lines] == [True]
    gate.passed(upload=True)
    assert (gate.failing_for_s, gate._pause_s) == (0.0, 0.0)
    assert "answers again" in lines[-1]
    gate.failed(FULL)
    gate.passed()
    assert gate.failing_for_s == 0.0, "no upload had failed"


def test_trouble_of_uploads_ends_with_the_last_image_to_send() -> None:
    gate = failing_gate([])
    gate.nothing_to_send()
    assert gate.failing_for_s > 0.0, "nothing was answered since"
    gate.passed()
    assert gate.failing_for_s == 0.0
    gate = failing_gate([])
    gate.passed()
    gate.nothing_to_send()
    assert gate.failing_for_s == 0.0


def test_a_service_that_stores_nothing_is_said_once_and_asked_ever_more_rarely(cell: WatchedCell) -> None:
    asked = Counter[str]()
    full = [True]

    def plan(method: str, path: str) -> Fault:
        asked[method] += 1
        return "busy" if method == "PUT" and full[0] else "none"

    cell.proxy.plan = plan
    with cell.watching(longest_pause_s=0.8):
        cell.write("P1/1.png", small_image(1))
        cell.write("P1/2.png", small_image(2))
        wait_until(lambda: asked["PUT"] >= 7, 120, "uploads are tried again")
        assert asked["POST"] >= 4, "what is cheap passes meanwhile"
        full[0] = False
        wait_until(lambda: cell.has(2), 120)
    assert sum("away" in line for line in cell.lines[:-1]) == 1, cell.lines
    assert sum("answers again" in line for line in cell.lines) == 1
    cell.assert_each_image_is_stored_once()
