"""Whether what is stated is true: coverage of intervals, power and false alarms of tests, errors of verdicts.

A module of this folder that has one subject has a function `trust_rows(seeds, quick)` that yields its rows;
`instruments` is a section of its own, and `shape_oracle` what `board_shape` compares with.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator, Sequence
from types import ModuleType

from benchmarks.table import Row


def rows(seeds: Sequence[int], quick: bool) -> Iterator[Row]:
    """Yield the rows of every subject, in the order of the modules' names."""
    for subject in subjects():
        yield from subject.trust_rows(seeds, quick)


def subjects() -> list[ModuleType]:
    """Return the modules that have rows of this section."""
    modules = (
        importlib.import_module(module.name) for module in pkgutil.iter_modules(__path__, f"{__name__}.")
    )
    return [module for module in modules if hasattr(module, "trust_rows")]
