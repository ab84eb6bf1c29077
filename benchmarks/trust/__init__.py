"""Whether what is stated is true: coverage of intervals, power and false alarms of tests, errors of verdicts.

Each module of this folder has one subject, and a function `trust_rows(seeds, quick)` that yields its rows.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator, Sequence

from benchmarks.table import Row


def rows(seeds: Sequence[int], quick: bool) -> Iterator[Row]:
    """Yield the rows of every subject, in the order of the modules' names."""
    for module in pkgutil.iter_modules(__path__, f"{__name__}."):
        yield from importlib.import_module(module.name).trust_rows(seeds, quick)
