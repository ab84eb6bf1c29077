"""`python -m benchmarks`: run every benchmark module, print its table, and keep benchmarks/RESULTS.md."""

from __future__ import annotations

import argparse
import importlib
import os
import pkgutil
import platform
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

import benchmarks
from benchmarks.table import Row, markdown, with_section

RESULTS = Path(__file__).parent / "RESULTS.md"
HEAD = """# Measured

Written by `make bench`; each section states the machine and the day of its own run. Ratios compare
within one run, accuracy is against rendered or drawn truth. Goals not met say NO and stay in the table.
"""


def main() -> int:
    names = [m.name for m in pkgutil.walk_packages(benchmarks.__path__, "benchmarks.")]
    names.remove("benchmarks.__main__")
    found = [m for m in map(importlib.import_module, names) if hasattr(m, "rows")]
    modules = {m.__name__.rpartition(".")[2]: m for m in found}
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "--only", action="append", choices=sorted(modules), help="run this module (repeatable)"
    )
    parser.add_argument(
        "--seed", action="append", type=int, dest="seeds", help="scene seed (repeatable; default 1 2 3)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="seconds instead of minutes; figures only indicative"
    )
    parser.add_argument("--no-write", action="store_true", help="leave benchmarks/RESULTS.md as it is")
    arguments = parser.parse_args()
    seeds = arguments.seeds or [1, 2, 3]

    console = Console()
    for name in arguments.only or sorted(modules):
        started, load = time.perf_counter(), _load()
        rows: list[Row] = []
        for row in modules[name].rows(seeds, arguments.quick):
            rows.append(row)
            console.print(
                f"{name}: {row.what}: {row.measured} (goal {row.goal}) {row.verdict}", highlight=False
            )
        seconds = time.perf_counter() - started
        console.print(_table(name, rows))
        if not (arguments.no_write or arguments.quick):
            body = f"{_conditions(seeds, seconds, load)}\n\n{markdown(rows)}"
            document = RESULTS.read_text(encoding="utf-8") if RESULTS.exists() else HEAD
            RESULTS.write_text(with_section(document, name, body), encoding="utf-8")
    return 0


def _table(name: str, rows: list[Row]) -> Table:
    table = Table(title=name, title_justify="left")
    for column in ("what", "measured", "goal", "met", "how"):
        table.add_column(column)
    for row in rows:
        style = {True: "green", False: "red", None: ""}[row.met]
        table.add_row(row.what, row.measured, row.goal, row.verdict, row.note, style=style)
    return table


def _load() -> str:
    """Return the load of the machine: under other load, ratios that use all cores mean little."""
    return f"load average {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "load unknown"


def _conditions(seeds: list[int], seconds: float, load: str) -> str:
    cores = f"{os.cpu_count()} cores ({platform.machine()}, {platform.system()})"
    machine = f"{cores}, Python {platform.python_version()}"
    versions = f"numpy {np.__version__}, OpenCV {cv2.__version__}"
    chosen = ", ".join(map(str, seeds))
    run = f"seeds {chosen}; {load} at the start; took {seconds:.0f} s."
    return f"{datetime.now(UTC):%Y-%m-%d}, {machine}, {versions}; {run}"


if __name__ == "__main__":
    sys.exit(main())
