"""Shared by all tests: the check of shapes where it is asked for, and where the real data lies."""

from __future__ import annotations

import gc
import os
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
import structlog
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

from app.threads import limit_threads
from tests.support.environment.postgres import new_database

limit_threads()  # before numpy is loaded: with a thread of each core in every process the tests take many times as long

if os.environ.get("GRIDPOSE_TEST_SHAPES"):
    # Before any import of core: annotations such as Float[np.ndarray, "n 3"] become run-time checks, which make calls
    # of core 2 to 12 times slower. The numeric tower: an int is a fine float, as everywhere in Python.
    install_import_hook("core", "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))")

# What the library would write of a logged exception, coloured and with every variable, takes .5 s of processor time.
structlog.configure(
    processors=[
        *structlog.get_config()["processors"][:-1],
        structlog.dev.ConsoleRenderer(colors=False, exception_formatter=structlog.dev.plain_traceback),
    ]
)


def pytest_xdist_auto_num_workers() -> int:
    """Return how many processes `-n auto` runs: two more than there are cores.

    A third of the tests' time is spent waiting: for disks, for clocks, for services that start and end. With one more,
    two cores were busy for 82 % of the time, with two more for 91 %.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return cores + 2


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Leave to the collector of garbage what the tests make, and nothing that was there before.

    Modules and tests stay to the end. Looking through them again and again for what is no longer used finds nothing,
    and costs seconds while they are collected and tens of milliseconds in each full pass afterwards.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


_SHAPE_TESTS_PER_FILE = 2


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    _mark_shape_tests(items)
    _put_long_files_first(items)


def _put_long_files_first(items: list[pytest.Item]) -> None:
    """Order: services in processes of their own, files with slow tests, the rest; so no process waits for the last.

    Files stay whole, since tests of a file share fixtures.
    """
    system = Path(__file__).parent / "system"
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (system not in item.path.parents, item.path not in slow))


def _mark_shape_tests(items: list[pytest.Item]) -> None:
    """Mark the tests of `make test-shapes`: of each file of core's tests the first few that are quick, once each.

    A file tests a module or a path through several, so each path runs with its shapes checked. The page on Python goes
    through whole sessions. Fuzzing runs in processes of its own, without the check.
    """
    core, page = Path(__file__).parent / "core", Path(__file__).parent / "docs" / "test_python.py"
    chosen: dict[Path, set[str]] = {}
    for item in items:
        if item.path != page and (core not in item.path.parents or core / "fuzz" in item.path.parents):
            continue
        names = chosen.setdefault(item.path, set())
        name = getattr(item, "originalname", item.name)
        if name in names or len(names) == _SHAPE_TESTS_PER_FILE:
            continue
        if item.get_closest_marker("slow") or item.get_closest_marker("soak"):
            continue
        names.add(name)
        item.add_marker("shapes")


# Deadlines would make the suite depend on the machine's speed; the seed is fixed so that a failure repeats.
settings.register_profile(
    "gridpose", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("gridpose")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Real photographs and published measurements, which are not part of the project."""
    default = Path(__file__).parent.parent.parent / "shared" / "data"
    folder = Path(os.environ.get("GRIDPOSE_TEST_DATA", default))
    if not folder.is_dir():
        pytest.skip("the real photographs are not here: set GRIDPOSE_TEST_DATA to their folder")
    return folder


@pytest.fixture
def postgres_url() -> Iterator[str]:
    """The address of an empty PostgreSQL database of this test's own, dropped afterwards."""
    with new_database() as url:
        yield url
