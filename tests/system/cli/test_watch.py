"""`gridpose watch` as a process: killed anywhere, stopped in order, and over many files."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from tests.support.environment.fault_proxy import FaultProxy, at_random
from tests.support.image.images import small_image
from tests.support.service.service import TARGET, new_session, wait_until
from tests.support.service.watched import WatchedCell


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """One service for all tests here, which computes nothing."""
    with ServiceProcess(tmp_path_factory.mktemp("watch") / "data", {"GRIDPOSE_WORKERS": "0"}) as process:
        yield process


@pytest.fixture
def cell(service: ServiceProcess, tmp_path: Path) -> Iterator[WatchedCell]:
    """A folder for a session of its own."""
    key = service.admin_key or ""
    with ServiceClient(service.url, key) as client, FaultProxy(service.url) as proxy:
        made = WatchedCell(tmp_path, new_session(client, TARGET), proxy, key, client)
        made.folder.mkdir()
        yield made


@contextmanager
def watching(cell: WatchedCell, *options: str) -> Iterator[subprocess.Popen[str]]:
    """Run the command; what still runs at the end is killed."""
    state = ("--journal", str(cell.journal), "--state-file", str(cell.root / "state.json"))
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "app.cli", "watch", str(cell.folder), "--session", cell.session_id),
            *("--url", cell.proxy.url, "--settle-s", "0.1", "--poll-s", "0.05", *state, *options),
        ],
        env={**os.environ, "GRIDPOSE_KEY": cell.key},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def run_to_the_end(cell: WatchedCell) -> str:
    with watching(cell, "--once") as process:
        said, _ = process.communicate(timeout=7200)
    assert process.returncode == 0, said
    return said


def test_nothing_is_lost_or_stored_twice_whenever_it_is_killed(cell: WatchedCell) -> None:
    cell.proxy.plan = at_random(seed=5, share=0.2)
    rng = random.Random(9)
    for life in range(5):
        for number in range(30 * life, 30 * life + 30):
            cell.write(f"P{number % 3}/c{number + 1}.png", small_image(number))
        with watching(cell) as process:
            stored = len(cell.proxy.stored)
            wait_until(lambda before=stored: len(cell.proxy.stored) > before, 120, "an image is sent")
            time.sleep(rng.uniform(0.0, 0.3))  # the moment of the kill: a test of any
            process.send_signal(signal.SIGKILL)
            process.wait()
    assert "trying again" not in run_to_the_end(cell), "a line that fails often fills no log"
    files = {path.stat().st_ino for path in cell.folder.rglob("*.png")}
    assert cell.has(len(files))
    cell.proxy.answered.clear()  # an answer to a process that was killed was never read
    cell.assert_each_image_is_stored_once()


def test_it_ends_in_order_and_says_so(cell: WatchedCell) -> None:
    with watching(cell) as process:
        cell.write("P1/1.png", small_image(1))
        wait_until(lambda: cell.has(1), 120)
        with watching(cell) as second:
            said, _ = second.communicate(timeout=120)
            assert second.returncode == 2
            assert "Another process watches" in said
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    assert "1 stored" in said
    state = json.loads((cell.root / "state.json").read_text())
    assert (state["running"], state["stored"], state["troubles"]) == (False, 1, [])


def test_a_wrong_key_and_a_name_that_breaks_lines_are_said_in_one_line(cell: WatchedCell) -> None:
    cell.write("P1/a\nb\x1b[31m1.png", small_image(1))
    os.close(os.open(os.fsencode(cell.folder / "P1") + b"/\xff2.png", os.O_CREAT | os.O_WRONLY))
    key, cell.key = cell.key, "gp_wrong_key"
    with watching(cell, "--once", "--retry-timeout", "0.5") as process:
        said, _ = process.communicate(timeout=120)
    assert process.returncode == 1
    assert "refuses key or session" in said
    cell.key = key
    with watching(cell, "--once") as process:
        said, _ = process.communicate(timeout=120)
    assert process.returncode == 1, "a file whose name is no text was not sent"
    assert "\x1b" not in said
    assert all(line[:2] == "20" or line.startswith("ses_") for line in said.splitlines()), said


@pytest.mark.parametrize(
    "files",
    [
        pytest.param(300, id="short"),
        pytest.param(3_000, id="long", marks=pytest.mark.soak),
        pytest.param(20_000, id="longest", marks=pytest.mark.soak),
    ],
)
def test_thousands_of_files_through_a_faulty_line(cell: WatchedCell, files: int) -> None:
    cell.proxy.plan = at_random(seed=1, share=0.02)
    for number in range(files):
        cell.write(f"P{number % 30}/c{number // 30 + 1}.png", small_image(number))
    began = time.monotonic()
    with watching(cell, "--once") as process:
        # A share of the files: with a number of its own, a watcher that had sent them all was waited for in vain.
        wait_until(
            lambda: len(cell.proxy.stored) > files // 4 or process.poll() is not None,
            7200,
            "a quarter is sent",
        )
        assert process.poll() is None, "it ended before it was killed"
        process.send_signal(signal.SIGKILL)
    run_to_the_end(cell)
    print(f"{files} files in {time.monotonic() - began:.0f} s")
    assert cell.has(files)
    cell.proxy.answered.clear()
    cell.assert_each_image_is_stored_once()
