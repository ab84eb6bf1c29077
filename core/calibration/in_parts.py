"""Passes over many views in two threads at once: kernels hold no lock, and each writes its own views' results alone, so
that what comes out does not depend on how many threads there were.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

WORTH_IT = 100_000
"""Points from which on a second thread saves more than it costs."""


def in_two_parts(work: Callable[[int, int], None], count: int, points: int) -> None:
    """Run work(begin, end) over [0, count): in one part, or in two at once where there are many points."""
    middle = count // 2
    if points < WORTH_IT or middle == 0:
        work(0, count)
        return
    second = _helper().submit(work, middle, count)
    work(0, middle)
    second.result()


@cache
def _helper() -> ThreadPoolExecutor:
    """Return the second thread, started when it is first needed."""
    return ThreadPoolExecutor(1, "second-part")
