"""Watching a folder against a real service, through a proxy that fails: nothing lost, nothing twice."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from app.cli.main import app
from app.client import ServiceClient
from app.client.watch import CannotBegin
from tests.support.environment.fault_proxy import at_random
from tests.support.image.images import small_image
from tests.support.service.service import Api, ApiMaker, wait_until
from tests.support.service.watched import WatchedCell
from tests.system.faults.images import BOARD, image


@pytest.mark.slow
def test_each_image_is_stored_once_whatever_fails_on_the_way(cell: WatchedCell) -> None:
    cell.proxy.plan = at_random(seed=17, share=0.3)
    for number in range(1, 33):
        cell.write(f"P{number % 4}/{number}.png", small_image(number))
    summary = cell.watch()
    assert (summary.waiting, summary.gave_up) == (0, False), cell.lines
    assert min(cell.proxy.faults[fault] for fault in ("cut before", "cut after", "busy", "slow", "twice")) > 0
    cell.assert_each_image_is_stored_once()
    before = dict(cell.proxy.stored)
    again = cell.watch()
    assert (again.stored, dict(cell.proxy.stored)) == (0, before), "the journal knows them"
    cell.journal.unlink()
    fresh = cell.watch()
    assert (fresh.stored, dict(cell.proxy.stored)) == (0, before), "the service is asked what it has"


def test_a_service_that_is_away_is_waited_for_and_said_once(cell: WatchedCell) -> None:
    cell.proxy.away = True
    with cell.watching():
        cell.write("P1/1.png", small_image(1))
        wait_until(lambda: cell.proxy.faults["cut before"] >= 3, 120)
        cell.write("P1/2.png", small_image(2))
        cell.proxy.away = False
        wait_until(lambda: cell.has(2), 120)
    assert sum("away" in line for line in cell.lines[:-1]) == 1
    assert sum("answers again" in line for line in cell.lines) == 1
    cell.assert_each_image_is_stored_once()


def test_files_written_slowly_renamed_and_replaced(cell: WatchedCell) -> None:
    data = small_image(1)
    with cell.watching(settle_s=0.2):
        path = cell.write("P1/1.png", data[:40])
        with path.open("ab") as stream:
            for start in range(40, len(data), 100):
                stream.write(data[start : start + 100])
                stream.flush()
        wait_until(lambda: cell.has(1), 120)
        path.rename(path.with_name("7.png"))
        cell.write("P1/8.png", small_image(8))
        wait_until(lambda: cell.has(2), 120)
        cell.write("P1/8.png", small_image(9))
        wait_until(lambda: cell.has(3), 120)
    sent = [m["filename"] for m in cell.measurements()]
    assert sent == ["1.png", "8.png", "8.png"], "renaming sends nothing"
    assert not any(len(statuses) > 1 for statuses in cell.proxy.answered.values())


@pytest.mark.slow
def test_a_file_that_stays_incomplete_is_reported_and_waits(cell: WatchedCell) -> None:
    cell.write("P1/1.png", small_image(1)[:-20])
    cell.write("P1/2.png", small_image(2))
    summary = cell.watch()
    assert (summary.stored, summary.waiting) == (1, 1)
    assert any("1.png: not whole: it ends within" in line for line in cell.lines)
    cell.write("P1/1.png", small_image(1))
    assert cell.watch().stored == 1
    cell.assert_each_image_is_stored_once()


def test_a_file_that_is_renamed_into_place_is_sent_as_soon_as_it_appears(cell: WatchedCell) -> None:
    with cell.watching(complete="renamed", settle_s=3600.0):
        elsewhere = cell.root / "1.png"
        elsewhere.write_bytes(small_image(1))
        cell.write("P1/2.png.part", small_image(2)[:40])
        elsewhere.replace(cell.folder / "P1" / "1.png")
        wait_until(lambda: cell.has(1), 120)
        part = cell.write("P1/2.png.part", small_image(2))
        part.replace(part.with_suffix(""))
        wait_until(lambda: cell.has(2), 120)
    assert [m["filename"] for m in cell.measurements()] == ["1.png", "2.png"]
    cell.assert_each_image_is_stored_once()


def test_marker_files_say_when_an_image_is_complete(cell: WatchedCell) -> None:
    for number in (1, 2, 3):
        cell.write(f"P1/{number}.png", small_image(number))
    cell.write("P1/1.png.done", b"")
    cell.write("P1/2.done", b"")
    assert cell.watch(complete="marker").stored == 2
    assert [m["cycle"] for m in cell.measurements()] == [1, 2]


@pytest.mark.slow
def test_metadata_come_from_sidecars_a_table_and_numbers(cell: WatchedCell) -> None:
    cell.write("left/a.png", small_image(1))
    cell.write("left/a.json", json.dumps({"joint_angles_deg": [1, 2], "position_mm": [1, 2, 3]}).encode())
    cell.write("left/b.png", small_image(2))
    cell.write("poses.csv", b"file,pose_id,j1_deg,j2_deg\nleft/b.png,P7,3,4\n")
    cell.write("left/c.png", small_image(3))
    summary = cell.watch(sidecar="required", number_cycles=True)
    assert (summary.stored, summary.waiting) == (2, 1)
    by_name = {m["filename"]: m for m in cell.measurements()}
    assert by_name["a.png"]["joint_angles_deg"] == [1.0, 2.0]
    assert (by_name["b.png"]["pose_id"], by_name["b.png"]["joint_angles_deg"]) == ("P7", [3.0, 4.0])
    (tmp := cell.folder / "poses.csv").write_bytes(tmp.read_bytes() + b"left/c.png,left,5,6\n")
    assert cell.watch(sidecar="required", number_cycles=True).waiting == 0
    assert [(m["pose_id"], m["cycle"]) for m in cell.measurements()] == [("left", 1), ("P7", 1), ("left", 2)]
    pose = cell.direct.get(f"/v1/sessions/{cell.session_id}/poses/left")
    assert pose["position_mm"] == [1.0, 2.0, 3.0]


def test_commanded_poses_of_a_growing_table_are_sent_without_images(cell: WatchedCell) -> None:
    path = f"/v1/sessions/{cell.session_id}/poses"
    with cell.watching():
        table = cell.write("poses.csv", b"pose_id,x_mm,y_mm,z_mm\nP1,1,2,3\n")
        wait_until(lambda: len(list(cell.direct.items(path))) == 1, 120)
        table.write_bytes(table.read_bytes() + b"P2,1,2,x\nP3,4,5,6\n")
        wait_until(lambda: len(list(cell.direct.items(path))) == 2, 120)
    assert any("line 3" in line and "not a number" in line for line in cell.lines)


def test_a_file_larger_than_memory_hinders_no_other(cell: WatchedCell) -> None:
    cell.write("P1/1.png", b"")
    os.truncate(cell.folder / "P1/1.png", 1 << 40)
    cell.write("P1/2.png", small_image(2))
    summary = cell.watch()
    assert (summary.stored, summary.waiting) == (1, 1)
    assert sum("P1/1.png: it cannot be read: it is larger than 1 GiB" in line for line in cell.lines) == 1


def test_an_image_that_is_refused_hinders_no_other(cell: WatchedCell) -> None:
    cell.write("P1/1.png", b"this is text")
    cell.write("測定/2.png", small_image(2))
    cell.write("Größe 1/3.png", small_image(3))
    summary = cell.watch()
    assert (summary.stored, summary.refused) == (1, 1)
    (stored,) = cell.measurements()
    assert (stored["pose_id"], stored["pose_label"]) == ("Groesse-1", "Größe 1")
    moved = cell.direct.change(f"/v1/measurements/{stored['id']}", {"pose_id": "P7"})
    assert moved["pose_label"] is None
    assert sum("unsupported_image" in line for line in cell.lines) == 1
    assert sum("not a pose ID" in line for line in cell.lines) == 1


@pytest.mark.slow
def test_images_that_the_service_lost_are_sent_again(cell: WatchedCell) -> None:
    for number in (1, 2):
        cell.write(f"P1/{number}.png", small_image(number))
    assert cell.watch().stored == 2
    cell.direct.delete(f"/v1/measurements/{cell.measurements()[0]['id']}")
    assert cell.watch().stored == 1
    assert cell.has(2)


def test_what_cannot_begin_says_so_and_what_may_come_back_is_waited_for(cell: WatchedCell) -> None:
    with pytest.raises(CannotBegin, match="session_not_found"):
        cell.watch(session="no such session")
    cell.proxy.away = True
    assert cell.watch(session="no such session", give_up_s=0.1).gave_up
    cell.proxy.away = False
    with cell.watching(folder=cell.root / "later"):
        wait_until(lambda: any("cannot be read" in line for line in cell.lines), 120)
        cell.folder.rename(cell.root / "later")
        wait_until(lambda: any("can be read again" in line for line in cell.lines), 120)


def test_a_key_that_is_refused_is_tried_until_it_is_accepted(cell: WatchedCell) -> None:
    right, cell.key = cell.key, cell.key[:-1] + ("a" if cell.key[-1] != "a" else "b")
    cell.write("P1/1.png", small_image(1))
    with cell.watching():
        wait_until(lambda: any("refuses key" in line for line in cell.lines), 120)
    cell.key = right
    assert cell.watch().stored == 1


@pytest.fixture(scope="module")
def computing(serve_api: ApiMaker) -> Iterator[Api]:
    with serve_api(workers=1) as running:
        yield running


@pytest.mark.slow
def test_results_are_printed_handed_over_and_moved(computing: Api, tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    program = f"import sys; open({str(taken)!r}, 'a').write(sys.stdin.read() + chr(10))"
    with WatchedCell.of(computing, tmp_path, **BOARD) as cell:
        cell.write("P1/1.png", image(0))
        cell.write("P1/2.png", image(5))  # shows no board
        command = f'"{sys.executable}" -c "{program}"'
        moved = tmp_path / "images" / "sent"
        summary = cell.watch(live=True, on_result=command, after="move", moved_to=moved)
        assert (summary.stored, summary.measured, summary.failed, summary.waiting) == (2, 1, 1, 0)
        assert sorted(p.relative_to(moved).as_posix() for p in moved.rglob("*.png")) == [
            "P1/1.png",
            "not-measured/P1/2.png",
        ]
        found = next(line for line in cell.lines if line.startswith("P1/1.png (P1 cycle 1), found"))
        assert "tilt" in found
        assert "points" in found
        assert any("2.png" in line and "target_not_found" in line and "->" in line for line in cell.lines)
        results = [json.loads(line) for line in taken.read_text().splitlines()]
        assert {r["measurement"]["status"] for r in results} == {"succeeded", "failed"}
        cell.write("P1/3.png", image(8))
        assert cell.watch(after="delete", moved_to=moved).measured == 1
        assert not (cell.folder / "P1" / "3.png").exists()
        assert any("deleted" not in line for line in cell.lines)
        with ServiceClient(cell.proxy.url, cell.key) as client:
            assert client.get(f"/v1/sessions/{cell.session_id}")["counts"]["succeeded"] == 2


@pytest.mark.slow
def test_the_bell_rings_for_an_image_without_result_and_the_code_says_so(
    computing: Api, tmp_path: Path
) -> None:
    with WatchedCell.of(computing, tmp_path, **BOARD) as cell:
        cell.write("P1/1.png", image(0))
        watch = ("watch", str(cell.folder), "--session", cell.session_id, "--url", cell.proxy.url, "--once")
        files = ("--journal", str(cell.journal), "--state-file", str(tmp_path / "state.json"))
        quick = ("--bell", "--poll-s", "0.1", "--settle-s", "0.1")
        ended = CliRunner().invoke(app, [*watch, *files, *quick], env={"GRIDPOSE_KEY": cell.key})
        assert (ended.exit_code, ended.output.count("\a")) == (0, 0), ended.output
        cell.write("P1/2.png", image(5))  # shows no board
        ended = CliRunner().invoke(app, [*watch, *files, *quick], env={"GRIDPOSE_KEY": cell.key})
        assert (ended.exit_code, ended.output.count("\a")) == (1, 1), ended.output
        state = json.loads((tmp_path / "state.json").read_text(encoding="utf-8"))
        assert (state["running"], state["waiting"], state["trouble_count"]) == (False, 0, 0)


@pytest.mark.slow
def test_the_next_view_is_printed_after_each_round_of_results(computing: Api, tmp_path: Path) -> None:
    with WatchedCell.of(computing, tmp_path, **BOARD) as cell:
        cell.write("P1/1.png", image(0))
        assert cell.watch(next_view="hand_eye").measured == 1
        said = [line for line in cell.lines if line.startswith("next: ")]
        assert len(said) == 1
        assert "mm away" not in said[0], "without commanded poses the advice is to send them"
        for number in range(1, 4):
            cell.write(f"P{number + 1}/1.png", image(number))
        assert cell.watch(next_view="intrinsics").measured == 3
        assert [line for line in cell.lines if line.startswith("next: ")][-1].partition(" mm away")[1]
        count = len(cell.lines)
        cell.write("P9/1.png", image(6))
        assert cell.watch().measured == 0, "results are not followed unless asked for"
        assert not any(line.startswith("next: ") for line in cell.lines[count:])


def test_a_key_of_scope_ingest_suffices_for_a_session_given_by_its_id(cell: WatchedCell) -> None:
    made = cell.direct.create("/v1/keys", {"name": "cell", "scope": "ingest"})
    cell.key = made["key"]
    cell.write("P1/0.png", small_image(1))
    cell.write("P1/1.png", small_image(2))
    cell.write("poses.csv", b"pose_id,x_mm,y_mm,z_mm\nP1,1,2,3\n")
    assert cell.watch(first_cycle=0).stored == 2
    assert [m["cycle"] for m in cell.measurements()] == [1, 2]
    assert cell.direct.get(f"/v1/sessions/{cell.session_id}/poses/P1")["position_mm"] == [1.0, 2.0, 3.0]
    with pytest.raises(CannotBegin, match="insufficient_scope") as refused:
        cell.watch(session="by name")
    assert "Give the session's id" in (refused.value.advice or "")
