"""The dashboard: how soon a page answers to its reader, how soon it shows a result, and what it costs the workers."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable

from benchmarks.service.browser.live import live_rows
from benchmarks.service.browser.visits import visit_rows
from benchmarks.table import Row

__all__ = ["rows"]


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    """Measure in Chromium; nothing without it."""
    chromium = os.environ.get("GRIDPOSE_TEST_CHROMIUM") or shutil.which("chromium")
    if chromium is None:
        return
    yield from visit_rows(chromium, seeds, quick)
    yield from live_rows(chromium, seeds, quick)
