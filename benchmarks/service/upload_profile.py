"""Where the processor time of an upload goes in the process that takes it, stage by stage and in turns with the bare
reference: `python -m benchmarks --profile upload`.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterable, Mapping
from itertools import count
from pathlib import Path
from statistics import median
from typing import Any

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from benchmarks.service.connection import Route, measurement_route, variant
from benchmarks.service.processor_time import (
    BLOCK,
    TARGET,
    await_measured,
    processor_seconds,
    send_block,
    small_jpeg,
)
from benchmarks.service.reference import ReferenceProcess
from benchmarks.service.throughput import new_session
from benchmarks.table import Row

_LEAST_SHARE = 0.004
"""Of the whole; stages below it are put together."""
_THREADS = {
    "MainThread": "event loop",
    "upload": "upload thread",
    "runner": "runner",
    "worker-answers": "results from processes",
}


def profile_rows(seed: int, quick: bool) -> Iterable[Row]:
    """Yield what an upload costs by thread and stage: without workers, and with two that measure the images."""
    image = small_jpeg(seed)
    for workers in (0, 2):
        yield from _profiled(image, workers, 6 if quick else 30)


def _profiled(image: bytes, workers: int, blocks: int) -> Iterable[Row]:
    environment = {"GRIDPOSE_WORKERS": str(workers)}
    numbers = count()
    bare: list[float] = []
    plain: list[float] = []
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        folder = Path(name)
        account = folder / "account.json"
        wrapper = (sys.executable, "-m", "benchmarks.service.stages", str(account))
        with (
            ReferenceProcess(folder / "bare") as reference,
            ServiceProcess(folder / "plain", environment) as without,
            ServiceProcess(folder / "staged", environment, wrapper=wrapper) as staged,
        ):
            to_bare = Route(reference.port, "/images/P1/{sha256}")
            to_plain, to_staged = _route(without), _route(staged)
            first: Mapping[str, Any] = {}
            for block in range(blocks + 1):
                images = [variant(image, next(numbers)) for _ in range(BLOCK)]
                costs = [
                    _cost(to_bare, images, reference.process.pid, None),
                    _cost(to_plain, images, without.process.pid, without.data_dir if workers else None),
                ]
                _cost(to_staged, images, staged.process.pid, staged.data_dir if workers else None)
                if block == 0:  # it warms connections, caches and workers
                    first = _read(staged.process.pid, account)
                else:
                    bare.append(costs[0])
                    plain.append(costs[1])
            last = _read(staged.process.pid, account)
    uploads = blocks * BLOCK
    what, unit = f"{workers} workers", "µs"
    per_upload = 1e6 * median(bare)
    ratio = median(ours / theirs for ours, theirs in zip(plain, bare, strict=True))
    yield Row.context(f"{what}: bare upload", per_upload, unit, f"{uploads} uploads in turns, median")
    yield Row.at_most(
        f"{what}: upload in the service ÷ bare upload",
        ratio,
        2.5 if workers else 2.0,
        note=f"{1e6 * median(plain):.0f} µs without the instruments",
    )
    yield from _stage_rows(what, first, last, uploads, per_upload)


def _route(service: ServiceProcess) -> Route:
    with ServiceClient(service.url, service.admin_key) as client:
        session_id = new_session(client, TARGET)
    assert service.admin_key is not None
    return measurement_route(service.url, session_id, service.admin_key)


def _cost(route: Route, images: list[bytes], pid: int, measured_in: Path | None) -> float:
    return send_block(
        route, images, pid, (lambda: await_measured(measured_in)) if measured_in is not None else lambda: None
    )


def _read(pid: int, account: Path) -> Mapping[str, Any]:
    """Return the account that a staged service keeps, as it is now."""
    account.unlink(missing_ok=True)
    before = processor_seconds(pid)
    os.kill(pid, signal.SIGUSR1)
    while not account.exists():
        time.sleep(0.01)
    document: Mapping[str, Any] = json.loads(account.read_text(encoding="utf-8"))
    assert document["process_ns"] >= 1e9 * before, "an account of before"
    return document


def _stage_rows(
    what: str, first: Mapping[str, Any], last: Mapping[str, Any], uploads: int, bare_us: float
) -> Iterable[Row]:
    def per_upload(after: float, before: float) -> float:
        return (after - before) / 1000.0 / uploads

    whole = per_upload(last["process_ns"], first["process_ns"])
    yield Row.context(f"{what}: upload under the instruments", whole, "µs", "the sum of what follows")
    rest = whole
    for thread, spent in sorted(last["threads_ns"].items(), key=lambda item: -item[1]):
        total = per_upload(spent, first["threads_ns"].get(thread, 0))
        stages = {
            stage: per_upload(ns, first["stages_ns"].get(thread, {}).get(stage, 0))
            for stage, ns in last["stages_ns"].get(thread, {}).items()
        }
        rest -= total
        if total < _LEAST_SHARE * whole:
            rest += total
            continue
        name = _THREADS.get(thread, thread)
        yield _row(f"{what}: {name}", total, bare_us, "all of it")
        small = sum(us for us in stages.values() if us < _LEAST_SHARE * whole)
        for stage, us in sorted(stages.items(), key=lambda item: -item[1]):
            if us >= _LEAST_SHARE * whole:
                calls = (last["calls"][stage] - first["calls"].get(stage, 0)) / uploads
                yield _row(f"{what}: {name}: {stage}", us, bare_us, f"{calls:.2g} calls an upload")
        unnamed = total - sum(stages.values())
        if stages:
            yield _row(f"{what}: {name}: stages below {_LEAST_SHARE:.1%} of the upload", small, bare_us, "")
            yield _row(f"{what}: {name}: outside of all stages", unnamed, bare_us, "")
    yield _row(f"{what}: other threads", rest, bare_us, "")


def _row(what: str, us: float, bare_us: float, note: str) -> Row:
    share = f"{us / bare_us:.2f} of a bare upload"
    return Row(what, f"{us:.0f} µs", note=f"{share}; {note}" if note else share)
