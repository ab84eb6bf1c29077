"""Many small images at once, while workers compute on the same cores; the bare figures are of the same load."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from statistics import median

import cv2
import numpy as np

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from benchmarks.service.connection import Route, measurement_route, variant
from benchmarks.service.processor_time import TARGET, await_measured, small_jpeg
from benchmarks.service.reference import ReferenceProcess
from benchmarks.service.throughput import new_session
from benchmarks.table import Row
from core import GridposeError, calibrate_image

CLIENTS, WORKERS = 8, 2
CROWD_BYTES = 150_000


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    image = small_jpeg(seeds[0])
    yield from _crowd(_padded(image, CROWD_BYTES), 80 if quick else 800)
    yield from _small(image, 60 if quick else 600, 2 if quick else 5)


def _crowd(image: bytes, uploads: int) -> Iterable[Row]:
    """Upload by eight clients while two workers measure; hash, write and flush the same with two busy processes."""
    images = [variant(image, number) for number in range(uploads)]
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        folder = Path(name)
        with _busy(image), ThreadPoolExecutor(CLIENTS) as threads:
            files = [folder / f"{number}" for number in range(uploads)]
            bare = list(threads.map(_kept, files, images))
        with _service(folder / "data") as route:
            _send(route, [variant(image, -1 - number) for number in range(4 * CLIENTS)])  # all is loaded
            started = time.perf_counter()
            answers = _send(route, images)
            taken = time.perf_counter() - started
    note = f"{uploads} JPEG of {len(image) / 1000:.0f} kB, {WORKERS} workers compute meanwhile"
    p50, p99 = 1000 * median(answers), 1000 * float(np.quantile(answers, 0.99))
    yield Row.at_least(f"{CLIENTS} clients: images acknowledged", uploads / taken, 60.0, "1/s", note)
    yield Row.at_most(f"{CLIENTS} clients: acknowledgement, median", p50, 20.0, "ms", note)
    yield Row.at_most(f"{CLIENTS} clients: acknowledgement, p99", p99, 60.0, "ms", note)
    base = 1000 * median(bare)
    note = f"median of hash, write and fsync by {CLIENTS} threads alongside {WORKERS} busy processes {base:.2f} ms"
    what = f"{CLIENTS} clients: acknowledgement ÷ SHA-256 + write + fsync"
    yield Row.at_most(f"{what}, median", p50 / base, 20.0, note=note)
    yield Row.at_most(f"{what}, p99", p99 / base, 60.0, note=note)


def _small(image: bytes, images: int, repeats: int) -> Iterable[Row]:
    """Measure small images with the service, and by a bare loop while the bare reference takes the same uploads."""
    numbers = count()
    ours, bare = [], []
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        folder = Path(name)
        with (
            ReferenceProcess(folder / "bare") as reference,
            ProcessPoolExecutor(WORKERS, multiprocessing.get_context("spawn"), _prepare) as pool,
            _service(folder / "data") as route,
        ):
            to_bare = Route(reference.port, "/images/P1/{sha256}")
            for repeat in range(repeats + 1):
                data = [variant(image, next(numbers)) for _ in range(images)]
                started = time.perf_counter()
                sender = threading.Thread(target=_send, args=(to_bare, data))
                sender.start()
                list(pool.map(_calibrated, data, chunksize=4))
                sender.join()
                bare_s = time.perf_counter() - started
                started = time.perf_counter()
                _send(route, data)
                await_measured(folder / "data")
                if repeat:  # the first round warms both
                    bare.append(images / bare_s)
                    ours.append(images / (time.perf_counter() - started))
    note = f"{images} JPEG of {len(image) / 1000:.0f} kB, {repeats} times in turns, {WORKERS} processes each, medians"
    yield Row.context("small images: bare loop alongside the bare reference", median(bare), "images/s", note)
    yield Row.context("small images: HTTP, upload to result", median(ours), "images/s", note)
    ratio = median(o / b for o, b in zip(ours, bare, strict=True))
    what = "small images: HTTP images/s ÷ bare loop alongside the bare reference"
    yield Row.at_least(what, ratio, 0.85, note=note)


@contextmanager
def _service(data_dir: Path) -> Iterator[Route]:
    """Run a service with two workers; give where a session of it takes images."""
    with (
        ServiceProcess(data_dir, {"GRIDPOSE_WORKERS": str(WORKERS)}) as service,
        ServiceClient(service.url, service.admin_key) as client,
    ):
        assert service.admin_key is not None
        yield measurement_route(service.url, new_session(client, TARGET), service.admin_key)


@contextmanager
def _busy(image: bytes) -> Iterator[None]:
    """Have as many processes as there are workers calibrate images, one after another."""
    context = multiprocessing.get_context("spawn")
    done, ready = context.Event(), context.Semaphore(0)
    processes = [context.Process(target=_work, args=(image, done, ready)) for _ in range(WORKERS)]
    for process in processes:
        process.start()
    for _ in processes:
        ready.acquire()
    try:
        yield
    finally:
        done.set()
        for process in processes:
            process.join()


def _work(image: bytes, done: threading.Event, ready: threading.Semaphore) -> None:
    _prepare()
    _calibrated(image)
    ready.release()
    while not done.is_set():
        _calibrated(image)


def _prepare() -> None:
    cv2.setNumThreads(1)


def _calibrated(image: bytes) -> bool:
    try:
        calibrate_image(image, TARGET)
    except GridposeError:
        return False
    return True


def _kept(file: Path, data: bytes) -> float:
    """Return how long it takes to hash a file and bring it to the disk, s."""
    started = time.perf_counter()
    hashlib.sha256(data).hexdigest()
    with file.open("wb", buffering=0) as opened:
        opened.write(data)
        os.fsync(opened.fileno())
    return time.perf_counter() - started


def _send(route: Route, images: Sequence[bytes]) -> list[float]:
    """Send images by eight clients, each over its own connection; return how long each acknowledgement took, s."""

    def client(number: int) -> list[float]:
        connection = route.connect()
        try:
            return [route.send(connection, image) for image in images[number::CLIENTS]]
        finally:
            connection.close()

    with ThreadPoolExecutor(CLIENTS) as threads:
        return [seconds for of_client in threads.map(client, range(CLIENTS)) for seconds in of_client]


def _padded(image: bytes, size: int) -> bytes:
    """Return a JPEG of about `size` bytes that shows the same: comments are added after its beginning."""
    part = 60_000
    padding = b""
    while len(image) + len(padding) < size:
        length = min(part, size - len(image) - len(padding))
        padding += b"\xff\xfe" + (length + 2).to_bytes(2, "big") + bytes(length)
    return image[:2] + padding + image[2:]
