"""Numbers that the watcher gives to images without a cycle."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import pytest

from app.client import ServiceClient
from app.client.watch import Journal, Report
from app.client.watch.cycles import CycleNumbers
from app.client.watch.journal import Entry
from tests.support.environment.fault_proxy import Fault
from tests.support.image.images import small_image
from tests.support.service.instant_service import InstantService
from tests.support.service.watched import WatchedCell


class FirstPutsFail:
    """A plan under which this many uploads of images meet a fault, and nothing else does."""

    def __init__(self, fault: Fault, count: int) -> None:
        self.fault, self.left = fault, count

    def __call__(self, method: str, path: str) -> Fault:
        if method != "PUT" or self.left <= 0:
            return "none"
        self.left -= 1
        return self.fault


def cycles_of(cell: WatchedCell) -> list[tuple[str, int | None]]:
    return sorted((m["pose_id"], m["cycle"]) for m in cell.measurements())


@pytest.mark.parametrize("fault", ["busy", "cut before", "cut after"])
def test_failed_attempts_use_up_no_number(cell: WatchedCell, fault: Fault) -> None:
    cell.proxy.plan = FirstPutsFail(fault, 6)
    for name in "abc":
        cell.write(f"P1/{name}.png", small_image(ord(name)))
        cell.write(f"P2/{name}.png", small_image(ord(name)))
    assert cell.watch(number_cycles=True).waiting == 0
    assert cycles_of(cell) == [(pose, cycle) for pose in ("P1", "P2") for cycle in (1, 2, 3)]
    cell.write("P1/d.png", small_image(9))
    assert cell.watch(number_cycles=True).stored == 1
    assert cycles_of(cell)[:4] == [("P1", 1), ("P1", 2), ("P1", 3), ("P1", 4)]


def test_a_refused_image_uses_up_no_number(cell: WatchedCell) -> None:
    cell.write("P1/a.png", b"this is text")
    cell.write("P1/b.png", small_image(2))
    assert cell.watch(number_cycles=True, parallel=1).refused == 1
    assert cycles_of(cell) == [("P1", 1)]


def numbers_of(journal: Journal) -> CycleNumbers:
    return CycleNumbers(cast(ServiceClient, InstantService()), journal, Report(print, None, {}), "s1")


def test_a_number_stays_with_its_image_over_restarts(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.sqlite")
    numbers = numbers_of(journal)
    assert [numbers.number("P1", sha256) for sha256 in ("a", "b", "a", "b")] == [1, 2, 1, 2]
    assert numbers.number("P2", "a") == 1
    numbers.keep("P1", "b")
    numbers.keep("P1", "b")
    journal.close()
    journal = Journal(tmp_path / "journal.sqlite")
    numbers = numbers_of(journal)
    assert numbers.of("P1", "b") == 2
    assert numbers.of("P1", "a") is None, "no attempt with it had failed"
    assert numbers.number("P1", "c") == 3
    journal.record("s1", Entry("b.png", "1:1:1", "P1", 2, "b", "done"))
    numbers.release("P1", "b")
    assert journal.numbers("s1") == []
    numbers.release("P1", "c")
    assert numbers.number("P1", "d") == 3
    journal.close()


@pytest.mark.parametrize("kept", ["all", "one", "none"])
def test_without_its_journal_numbering_goes_on_from_the_service(cell: WatchedCell, kept: str) -> None:
    files = [cell.write(f"P1/{name}.png", small_image(ord(name))) for name in "abc"]
    assert cell.watch(number_cycles=True).stored == 3
    cell.journal.unlink()
    for path in {"all": [], "one": files[1:], "none": files}[kept]:
        path.unlink()  # as measured files are moved away
    cell.write("P1/d.png", small_image(100))
    assert cell.watch(number_cycles=True).stored == 1
    assert cycles_of(cell) == [("P1", cycle) for cycle in (1, 2, 3, 4)]
    cell.write("P1/e.png", small_image(101))
    assert cell.watch(number_cycles=True).stored == 1
    assert cycles_of(cell)[-1] == ("P1", 5)
    assert not any("number twice" in line for line in cell.lines)


def test_images_that_were_there_already_keep_their_cycles_in_the_journal(cell: WatchedCell) -> None:
    cell.write("P1/a.png", small_image(1))
    cell.write("P1/b.png", small_image(2))
    assert cell.watch(number_cycles=True).stored == 2
    cell.journal.unlink()
    assert cell.watch(number_cycles=True).stored == 0
    journal = Journal(cell.journal)
    assert journal.last_cycle(cell.session_id, "P1") == 2
    journal.close()


def test_a_key_that_may_not_read_says_once_that_numbers_may_repeat(cell: WatchedCell) -> None:
    cell.key = cell.direct.create("/v1/keys", {"name": "cell", "scope": "ingest"})["key"]
    for name in ("P1/a.png", "P1/b.png", "P2/a.png"):
        cell.write(name, small_image(len(name) + ord(name[3])))
    assert cell.watch(number_cycles=True).stored == 3
    assert sum("number twice" in line for line in cell.lines) == 1, cell.lines
    cell.write("P1/c.png", small_image(5))
    assert cell.watch(number_cycles=True).stored == 1
    assert sum("number twice" in line for line in cell.lines) == 1, "the journal knows the pose"
    assert cycles_of(cell) == [("P1", 1), ("P1", 2), ("P1", 3), ("P2", 1)]


def test_an_image_that_is_sent_again_keeps_its_number(cell: WatchedCell) -> None:
    for name in "abc":
        cell.write(f"P1/{name}.png", small_image(ord(name)))
    assert cell.watch(number_cycles=True).stored == 3
    before = {m["filename"]: m["cycle"] for m in cell.measurements()}
    for measurement in cell.measurements()[:2]:
        cell.direct.delete(f"/v1/measurements/{measurement['id']}")
    assert cell.watch(number_cycles=True).stored == 2
    assert {m["filename"]: m["cycle"] for m in cell.measurements()} == before
    assert sum("no longer has 2 images" in line for line in cell.lines) == 1


def test_an_image_whose_measurement_is_excluded_is_not_sent_again(cell: WatchedCell) -> None:
    cell.write("P1/a.png", small_image(1))
    assert cell.watch().stored == 1
    (sent,) = cell.measurements()
    cell.direct.change(f"/v1/measurements/{sent['id']}", {"excluded": {"reason": "A hand in front."}})
    assert cell.watch().stored == 0
    assert [m["excluded"] is not None for m in cell.measurements()] == [True]
