"""Processor time of an upload in the process that takes it, next to the bare reference's in the same run."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from statistics import median

import cv2

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from app.records.database import sqlite_driver
from benchmarks.service.connection import Route, measurement_route, variant
from benchmarks.service.reference import ReferenceProcess
from benchmarks.service.throughput import new_session
from benchmarks.table import Row
from core.simulation import render
from tests.support.simulation.scenes import standard_scene, standard_target

TARGET = standard_target(9, 6)
IMAGE_BYTES = 25_000
_WAITING = "SELECT 1 FROM measurements WHERE status IN ('queued', 'running') LIMIT 1"
BLOCK = 50
"""Uploads to one server before it is the other's turn."""


def processor_time_rows(seed: int, quick: bool) -> Iterable[Row]:
    """Measure, in turns, the reference and the service: without workers, and with two that measure the images."""
    image = small_jpeg(seed)
    blocks = 6 if quick else 30
    for workers, limit in ((0, 2.0), (2, 2.5)):
        bare, ours, rate = _in_turns(image, workers, blocks)
        ratio = median(o / b for o, b in zip(ours, bare, strict=True))
        note = f"{len(image) / 1000:.0f} kB JPEG, {blocks} x {BLOCK} uploads in turns, one client; medians"
        if workers:
            note += f"; the runner included, {rate:.0f} images/s measured meanwhile"
        yield Row.context(
            f"processor time of a bare upload, {workers} workers in the service",
            1000 * median(bare),
            "ms",
            note,
        )
        yield Row.context(
            f"processor time of an upload in the service, {workers} workers", 1000 * median(ours), "ms", note
        )
        yield Row.at_most(f"the same ÷ the bare upload, {workers} workers", ratio, limit, note=note)


def _in_turns(image: bytes, workers: int, blocks: int) -> tuple[Sequence[float], Sequence[float], float]:
    bare: list[float] = []
    ours: list[float] = []
    numbers = count()
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        folder = Path(name)
        with (
            ReferenceProcess(folder / "bare") as reference,
            ServiceProcess(folder / "data", {"GRIDPOSE_WORKERS": str(workers)}) as service,
            ServiceClient(service.url, service.admin_key) as client,
        ):
            session_id = new_session(client, TARGET)
            assert service.admin_key is not None
            to_us = measurement_route(service.url, session_id, service.admin_key)
            to_bare = Route(reference.port, "/images/P1/{sha256}")
            sent, started = 0, 0.0
            for block in range(blocks + 1):
                images = [variant(image, next(numbers)) for _ in range(BLOCK)]
                for route, pid, spent in (
                    (to_bare, reference.process.pid, bare),
                    (to_us, service.process.pid, ours),
                ):
                    # What the runner does for these images is part of them: the block ends when it is done.
                    settle: Callable[[], None] = (
                        (lambda: await_measured(folder / "data"))
                        if workers and route is to_us
                        else lambda: None
                    )
                    cost = send_block(route, images, pid, settle)
                    if block:  # the first one warms connections, caches and workers
                        spent.append(cost)
                if block == 0:
                    started = time.perf_counter()
                else:
                    sent += BLOCK
            rate = sent / (time.perf_counter() - started)
    return bare, ours, rate


def send_block(route: Route, images: Sequence[bytes], pid: int, settle: Callable[[], None]) -> float:
    """Send images to a server and `settle`; return the processor time of process `pid` for each of them, s."""
    connection = route.connect()
    before = processor_seconds(pid)
    for image in images:
        route.send(connection, image)
    settle()
    spent = processor_seconds(pid) - before
    connection.close()
    return spent / len(images)


def await_measured(data_dir: Path) -> None:
    """Return when no image waits; the database is asked, since a request would cost the service what is measured."""
    module, _ = sqlite_driver()
    database = module.connect(f"file:{data_dir / 'gridpose.sqlite3'}?mode=ro", uri=True)
    try:
        while database.execute(_WAITING).fetchone() is not None:
            time.sleep(0.02)
    finally:
        database.close()


def processor_seconds(pid: int) -> float:
    """Return the processor time that all threads of a process have taken, s, by the kernel's clock of that process."""
    return time.clock_gettime((~pid << 3) | 2)


def small_jpeg(seed: int, size: int = IMAGE_BYTES) -> bytes:
    """Return a JPEG of about `size` bytes that shows the board, as a camera of a third of a megapixel takes it."""
    scene = standard_scene(TARGET, seed, tilt=math.radians(30.0), clutter=0.3)
    width, height = 640, 536
    factor = width / scene.width_px
    camera = replace(
        scene.camera,
        fx_px=scene.camera.fx_px * factor,
        fy_px=scene.camera.fy_px * factor,
        cx_px=(scene.camera.cx_px + 0.5) * factor - 0.5,
        cy_px=(scene.camera.cy_px + 0.5) * factor - 0.5,
    )
    image = render(replace(scene, camera=camera, width_px=width, height_px=height, noise_levels=2.0))
    encoded = [
        cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        for quality in range(50, 96, 3)
    ]
    return min(encoded, key=lambda data: abs(len(data) - size))
