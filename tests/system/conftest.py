"""Real services in processes of their own, and images to send them."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from app.cli.process import ServiceProcess


@pytest.fixture
def service(tmp_path: Path) -> Iterator[ServiceProcess]:
    """A running service with one worker on a new data folder."""
    with ServiceProcess(tmp_path / "data", {"GRIDPOSE_WORKERS": "1"}) as process:
        yield process


@pytest.fixture
def make_service(tmp_path: Path) -> Iterator[Callable[..., ServiceProcess]]:
    """Make services that are not started; those still running at the end are killed."""
    made: list[ServiceProcess] = []

    def make(name: str = "data", **environment: str) -> ServiceProcess:
        process = ServiceProcess(tmp_path / name, {"GRIDPOSE_WORKERS": "1", **environment})
        made.append(process)
        return process

    yield make
    for process in made:
        process.kill()


@pytest.fixture
def small_image() -> Callable[[int], bytes]:
    """Make distinct PNG files of a few hundred bytes that show no grid, so that thousands are quickly refused."""

    def make(number: int) -> bytes:
        picture = np.random.default_rng(number).integers(0, 256, (8, 24), dtype=np.uint8)
        written, data = cv2.imencode(".png", picture)
        assert written
        return data.tobytes()

    return make


@pytest.fixture
def photo(data_folder: Path) -> Path:
    """A real photograph of the 9 × 6 chessboard of 25 mm."""
    return data_folder / "opencv_samples" / "left01.jpg"


@pytest.fixture
def until() -> Callable[..., None]:
    """Wait until a condition holds; fail with its name when it does not in time."""

    def wait(condition: Callable[[], bool], within_s: float, what: str) -> None:
        deadline = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < deadline, f"not within {within_s:g} s: {what}"
            time.sleep(0.02)

    return wait


@pytest.fixture
def descendants() -> Callable[[int], set[int]]:
    """Find the running children, and theirs, of a process."""
    if not Path("/proc/self/stat").exists():
        pytest.skip("needs /proc to see processes")

    def find(pid: int) -> set[int]:
        parents = {}
        for stat in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):  # it ended while we looked
                state, parent = stat.read_text().rpartition(")")[2].split()[:2]
                if state != "Z":
                    parents[int(stat.parent.name)] = int(parent)
        found: set[int] = set()
        while more := {child for child, parent in parents.items() if parent in found | {pid}} - found:
            found |= more
        return found

    return find
