"""How long the tests take, from a clone that is set up: this one."""

from __future__ import annotations

from collections.abc import Iterable

from benchmarks.clone import REPOSITORY, make
from benchmarks.table import Row


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    del seeds
    make(REPOSITORY, "setup-dev")
    for target, limit in (("test", 5.0),) if quick else (("test", 5.0), ("test-all", 20.0)):
        yield Row.at_most(f"make {target}", make(REPOSITORY, target) / 60.0, limit, "min")
