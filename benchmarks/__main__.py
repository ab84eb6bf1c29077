"""`python -m benchmarks`: run every section, print its table and that of the goals, and keep benchmarks/RESULTS.md.

Sections can be run one by one with `--only`: the table of goals takes each figure from the latest run that is kept.
`--profile upload` prints and keeps where the processor time of an upload goes instead.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import os
import pkgutil
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

import benchmarks
from benchmarks.goals import Outcome, judged, outcomes_table, sections_of
from benchmarks.service.upload_profile import profile_rows
from benchmarks.table import Row, markdown, with_section

RESULTS = Path(__file__).parent / "RESULTS.md"
Rows = Callable[[list[int], bool], Iterable[Row]]
PROFILES: dict[str, Rows] = {"upload": lambda seeds, quick: profile_rows(seeds[0], quick)}
HEAD = """# Measured

Written by `make bench`; each section states the machine and the day of its own run, and what it
measures. Ratios compare within one run, accuracy is against rendered or drawn truth. Goals not met say
NO and stay in the table.
"""
GOALS_HEAD = """Every number to reach, from the latest run of each section; `python -m benchmarks --goals` prints the
table without running anything. Of more than three figures the smallest and the largest stand here; one that is short
makes the row short. What was tried for short rows: [ATTEMPTS.md](ATTEMPTS.md)."""


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
    parser.add_argument("--goals", action="store_true", help="run nothing: the table of goals from kept runs")
    parser.add_argument(
        "--profile", choices=sorted(PROFILES), help="print where the time of this goes, instead of benchmarks"
    )
    parser.add_argument("--no-write", action="store_true", help="leave benchmarks/RESULTS.md as it is")
    arguments = parser.parse_args()
    seeds = arguments.seeds or [1, 2, 3]

    console = Console()
    wanted = () if arguments.goals else arguments.only or sorted(modules)
    chosen: dict[str, Rows] = {name: modules[name].rows for name in wanted}
    if arguments.profile is not None:
        chosen = {f"profile of an {arguments.profile}": PROFILES[arguments.profile]}
    for name, measure in chosen.items():
        started, load = time.perf_counter(), _load()
        rows: list[Row] = []
        for row in measure(seeds, arguments.quick):
            rows.append(row)
            console.print(
                f"{name}: {row.what}: {row.measured} (goal {row.goal}) {row.verdict}", highlight=False
            )
        seconds = time.perf_counter() - started
        console.print(_table(name, rows))
        if not (arguments.no_write or arguments.quick):
            said = [_conditions(seeds, seconds, load), *_subject(modules.get(name)), markdown(rows)]
            body = "\n\n".join(said)
            document = RESULTS.read_text(encoding="utf-8") if RESULTS.exists() else HEAD
            RESULTS.write_text(with_section(document, name, body), encoding="utf-8")
    if arguments.profile is not None:
        return 0
    document = RESULTS.read_text(encoding="utf-8")
    outcomes = judged(sections_of(document))
    console.print(_goals_table(outcomes))
    if not arguments.no_write:
        RESULTS.write_text(with_goals(document, outcomes), encoding="utf-8")
    return 0


def _subject(module: ModuleType | None) -> list[str]:
    """Return what a section's module says it measures."""
    return [] if module is None else [inspect.cleandoc(module.__doc__ or "")]


def with_goals(document: str, outcomes: list[Outcome]) -> str:
    """Return the document with its table of goals replaced."""
    return with_section(document, "Goals", f"{GOALS_HEAD}\n\n{outcomes_table(outcomes)}")


def _goals_table(outcomes: list[Outcome]) -> Table:
    table = Table(title="goals", title_justify="left")
    for column in ("what", "goal", "measured", "", "run", "note"):
        table.add_column(column)
    styles = {"holds": "green", "SHORT": "red"}
    for one in outcomes:
        cells = (one.goal.what, one.goal.goal, one.measured, one.verdict, one.run, one.goal.note)
        table.add_row(*cells, style=styles.get(one.verdict, ""))
    return table


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
    return f"{datetime.now(UTC):%Y-%m-%d}, commit {_commit()}, {machine}, {versions}; {run}"


def _commit() -> str:
    """Return the commit that is measured, with a + where the code of the product differs from it."""
    where = RESULTS.parent.parent
    commit, changed = (
        subprocess.run(["git", *words], cwd=where, capture_output=True, text=True, check=False).stdout.strip()
        for words in (["rev-parse", "--short=7", "HEAD"], ["status", "--porcelain", "--", "core", "app"])
    )
    return f"{commit or 'unknown'}{'+' if changed else ''}"


if __name__ == "__main__":
    sys.exit(main())
