"""The service as its clients meet it: throughput, acknowledgements, and what an upload costs."""

from __future__ import annotations

from collections.abc import Iterable

from benchmarks.service.memory import memory_rows
from benchmarks.service.processor_time import processor_time_rows
from benchmarks.service.throughput import throughput_rows
from benchmarks.table import Row


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    yield from processor_time_rows(seeds[0], quick)
    yield from throughput_rows(seeds, quick)
    yield from memory_rows(seeds[0], quick)
