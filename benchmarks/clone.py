"""From a fresh clone: how long `make setup` takes, and until `make demo` has finished."""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from benchmarks.table import Row

REPOSITORY = Path(__file__).parents[1]


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    del seeds, quick  # there is one clone, and it takes its time
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        clone = Path(name) / "gridpose"
        started = time.monotonic()
        subprocess.run(["git", "clone", "--quiet", str(REPOSITORY), str(clone)], check=True)
        set_up = make(clone, "setup")
        yield Row.at_most("fresh clone: make setup", set_up, 50.0, "s", "packages from the registry included")
        make(clone, "demo")
        finished = time.monotonic() - started
        yield Row.at_most("fresh clone to make demo finished", finished, 120.0, "s", "setup included")


def make(folder: Path, target: str) -> float:
    """Run a target of the Makefile as a user would; return how long it took, s."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    started = time.monotonic()
    done = subprocess.run(
        ["make", target], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"make {target} failed:\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    return time.monotonic() - started
