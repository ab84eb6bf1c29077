"""`python -m benchmarks.public`: render the suite, run every detector on it, and print one table."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np

from benchmarks.conditions import one_core
from benchmarks.public.adapters import BUILT_IN, load
from benchmarks.public.photographs import calibration_table
from benchmarks.public.rendering import DEFAULT_FOLDER, prepare_images
from benchmarks.public.report import OURS, document, exceptions, table
from benchmarks.public.runner import measure
from benchmarks.public.suite import items
from benchmarks.table import with_section

RESULTS = Path(__file__).parents[1] / "RESULTS.md"


def main(argv: list[str] | None = None) -> int:
    """Run the benchmark; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.public", description=__doc__)
    parser.add_argument(
        "--adapter", action="append", help=f"one of {', '.join(BUILT_IN)}, or a .py file (repeatable)"
    )
    parser.add_argument("--cache", type=Path, default=DEFAULT_FOLDER, help="folder of the rendered images")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes that render")
    parser.add_argument("--quick", action="store_true", help="one seed of each scene")
    parser.add_argument("--photographs", type=Path, help="folder of photographs: compares calibrations, too")
    parser.add_argument("--json", type=Path, help="write every level's figures to this file")
    parser.add_argument("--write", action="store_true", help="put the tables into benchmarks/RESULTS.md")
    arguments = parser.parse_args(argv)
    try:
        adapters = [load(name) for name in arguments.adapter or BUILT_IN]
    except ValueError as error:
        parser.error(str(error))
    if all(adapter.name != OURS for adapter in adapters):
        adapters.append(load(OURS))  # the ratios' denominator

    suite = list(items(seeds=(1,))) if arguments.quick else list(items())
    started = time.perf_counter()
    rendered = prepare_images(suite, arguments.cache, arguments.jobs)
    print(f"{len(suite)} images, {rendered} of them rendered now ({time.perf_counter() - started:.0f} s).")
    started = time.perf_counter()
    scores, notes = measure(adapters, suite, arguments.cache)
    detail = exceptions(scores)
    body = [table(scores)]
    body += [f"Where another detector is ahead:\n\n{detail}"] if detail else []
    body += [note + "\n" for note in notes]
    if arguments.photographs is not None:
        with one_core():
            body.append(calibration_table(arguments.photographs))
    took = (
        f"{len(suite)} images of 1280x1024; detectors took {time.perf_counter() - started:.0f} s on one core."
    )
    print("\n" + "\n".join(body))
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(document(scores), indent=1) + "\n", encoding="utf-8")
    if arguments.write:
        text = f"{_conditions()}; {took}\n`python -m benchmarks.public{_options(arguments)}`. "
        text += "What is measured: [public/README.md](public/README.md).\n\n" + "\n".join(body)
        RESULTS.write_text(
            with_section(RESULTS.read_text(encoding="utf-8"), "public", text), encoding="utf-8"
        )
    return 0


def _options(arguments: argparse.Namespace) -> str:
    names = "".join(f" --adapter {name}" for name in arguments.adapter or [])
    return (
        names
        + (" --quick" if arguments.quick else "")
        + (" --photographs ..." if arguments.photographs else "")
    )


def _conditions() -> str:
    cores = f"{os.cpu_count()} cores ({platform.machine()}, {platform.system()})"
    load_now = f"load average {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "load unknown"
    versions = f"Python {platform.python_version()}, numpy {np.__version__}, OpenCV {cv2.__version__}"
    return f"{datetime.now(UTC):%Y-%m-%d}, {cores}, {versions}; {load_now}"


if __name__ == "__main__":
    sys.exit(main())
