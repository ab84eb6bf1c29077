"""Throughput and latency of the service, compared with a bare loop over the same files and a bare write."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import tempfile
import threading
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from statistics import median

import cv2
import numpy as np
from jaxtyping import UInt8

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from benchmarks.service.connection import Route, measurement_route, variant
from benchmarks.service.reference import ReferenceProcess
from benchmarks.table import Row
from core import TargetSpec, calibrate_image
from core.simulation import render
from tests.support.simulation.scenes import standard_scene, standard_target

TARGET = standard_target(14, 10)
POLL_S = 0.25  # a question costs the head some milliseconds; asked often it would measure itself


def throughput_rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    """Measure images per second with and without HTTP, and how long the acknowledgement of a large file takes."""
    images, repeats = (24, 2) if quick else (72, 5)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    rendered = _rendered(seeds, 3 if quick else 12)
    for kind, options in ((".png", ()), (".jpg", (cv2.IMWRITE_JPEG_QUALITY, 95))):
        encoded = [cv2.imencode(kind, image, options)[1].tobytes() for image in rendered]
        yield from _throughput("" if kind == ".png" else "JPEG: ", encoded, images, repeats, cores)
    yield from _acknowledgement(40 if quick else 400)


def _throughput(
    prefix: str, encoded: Sequence[bytes], images: int, repeats: int, cores: int
) -> Iterable[Row]:
    """Time, in turns: the bare loop with all processes and with one, and the service with as many workers.

    The client is on the same cores. What is left of them for the bare loop while the bare reference takes the same
    uploads by the same client is what a service without any cost of its own would reach.
    """
    bare: dict[int, list[float]] = {cores: [], 1: []}
    service: dict[int, list[float]] = {cores: [], 1: []}
    alongside: list[float] = []
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        folder = Path(name)
        with ExitStack() as stack:
            spawn = multiprocessing.get_context("spawn")
            pools = {
                n: stack.enter_context(ProcessPoolExecutor(n, mp_context=spawn, initializer=_prepare))
                for n in bare
            }
            reference = stack.enter_context(ReferenceProcess(folder / "reference"))
            for n, pool in pools.items():
                list(pool.map(_wait_a_little, range(n)))  # all of them started and loaded
            for repeat in range(repeats):
                files = _files(folder / f"files-{repeat}", encoded, images, repeat * images)
                for n, pool in pools.items():
                    started = time.perf_counter()
                    done = list(pool.map(_calibrate, files))
                    bare[n].append(images / (time.perf_counter() - started))
                    assert sum(done) > images / 2, "most of these images can be calibrated"
                started = time.perf_counter()
                sender = threading.Thread(
                    target=_send, args=(Route(reference.port, "/images/P1/{sha256}"), files)
                )
                sender.start()
                list(pools[cores].map(_calibrate, files))
                sender.join()
                alongside.append(images / (time.perf_counter() - started))
                for workers, rates in service.items():
                    rates.append(_service_rate(folder / f"data-{repeat}-{workers}", files, workers))
    size = sum(map(len, encoded)) / len(encoded) / 1e6
    note = f"{images} images of 5 Mpx, 14x10, {size:.1f} MB, {repeats} times in turns, medians"
    yield Row.context(f"{prefix}bare loop, {cores} processes", median(bare[cores]), "images/s", note)
    yield Row.context(f"{prefix}bare loop alongside the bare reference", median(alongside), "images/s", note)
    yield Row.context(
        f"{prefix}HTTP, upload to result, {cores} workers", median(service[cores]), "images/s", note
    )
    for what, others in (
        ("bare loop with as many processes", bare[cores]),
        ("bare loop alongside the bare reference", alongside),
    ):
        ratio = median(s / b for s, b in zip(service[cores], others, strict=True))
        yield Row.at_least(f"{prefix}HTTP images/s ÷ {what}", ratio, 0.85, note="client on the same cores")
    if cores > 1:
        gain, machine = (
            median(n / one for n, one in zip(rates[cores], rates[1], strict=True))
            for rates in (service, bare)
        )
        yield Row.context(
            f"{prefix}{cores} processes ÷ 1, bare loop",
            machine,
            note="what the machine's cores and memory allow",
        )
        yield Row.at_least(
            f"{prefix}{cores} workers ÷ 1, by HTTP", gain, 0.95 * cores, note="client on the same cores"
        )


def _acknowledgement(uploads: int) -> Iterable[Row]:
    """Time, in turns: hash, write and fsync of a 3 MB file, and the answers to its upload; nothing else runs.

    The client costs next to nothing and hashes before it sends. The bare reference shows what HTTP itself takes.
    """
    size = (1730, 1730)
    png = cv2.imencode(".png", np.random.default_rng(3).integers(0, 256, size, dtype=np.uint8))[1].tobytes()
    what = ("SHA-256 + write + fsync", "bare reference's acknowledgement", "acknowledgement")
    times: dict[str, list[float]] = {name: [] for name in what}
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        folder = Path(name)
        with (
            ReferenceProcess(folder / "reference") as reference,
            ServiceProcess(folder / "data", {"GRIDPOSE_WORKERS": "0"}) as service,
            ServiceClient(service.url, service.admin_key) as client,
        ):
            assert service.admin_key is not None
            to_us = measurement_route(service.url, new_session(client), service.admin_key)
            to_reference = Route(reference.port, "/images/P1/{sha256}")
            ours, theirs = to_us.connect(), to_reference.connect()
            for number in range(uploads + 10):
                data = variant(png, number)
                started = time.perf_counter()
                hashlib.sha256(data).hexdigest()
                with (folder / "bare").open("wb", buffering=0) as file:
                    file.write(data)
                    os.fsync(file.fileno())
                times[what[0]].append(time.perf_counter() - started)
                times[what[1]].append(to_reference.send(theirs, data))
                times[what[2]].append(to_us.send(ours, data))
            ours.close()
            theirs.close()
    kept = {name: taken[10:] for name, taken in times.items()}  # the first ones warm connections and caches
    note = f"{uploads} uploads of {len(png) / 1e6:.1f} MB, in turns"
    for name, taken in kept.items():
        tail = f"p90 {1000 * np.quantile(taken, 0.9):.1f} ms, p99 {1000 * np.quantile(taken, 0.99):.1f} ms"
        yield Row.context(f"{name} of 3 MB, median", 1000 * median(taken), "ms", tail)
    for name, quantile, limit in (("median", 0.5, 1.8), ("p90", 0.9, 2.5)):
        bare, reference_s, ours_s = (float(np.quantile(taken, quantile)) for taken in kept.values())
        yield Row.at_most(f"{what[2]} ÷ {what[0]}, {name}", ours_s / bare, limit, note=note)
        yield Row.context(f"{what[1]} ÷ {what[0]}, {name}", reference_s / bare, note=note)


def _service_rate(data_dir: Path, files: Sequence[Path], workers: int) -> float:
    with (
        ServiceProcess(data_dir, {"GRIDPOSE_WORKERS": str(workers)}) as service,
        ServiceClient(service.url, service.admin_key) as client,
    ):
        assert service.admin_key is not None
        session_id = new_session(client)
        _warm_up(client, files[0], workers)
        started = datetime.now(UTC)
        _send(measurement_route(service.url, session_id, service.admin_key), files)
        await_all(client, session_id, len(files))
        # The service says when the last result was stored, more exactly than asking now and then could.
        listed = list(client.items(f"/v1/sessions/{session_id}/measurements"))
        last = max(datetime.fromisoformat(item["finished_at"]) for item in listed)
        assert len(listed) == len(files)
        return len(files) / (last - started).total_seconds()


def _send(route: Route, files: Sequence[Path]) -> None:
    """Send files by two clients."""

    def client(number: int) -> None:
        connection = route.connect()
        try:
            for file in files[number::2]:
                route.send(connection, file.read_bytes())
        finally:
            connection.close()

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(client, range(2)))


def _warm_up(client: ServiceClient, file: Path, workers: int) -> None:
    session_id = new_session(client)
    for number in range(4 * workers):
        data = variant(file.read_bytes(), 10_000 + number)
        client.put_image(session_id, "P1", hashlib.sha256(data).hexdigest(), data)
    await_all(client, session_id, 4 * workers)


def await_all(client: ServiceClient, session_id: str, images: int) -> None:
    """Return when so many images of a session are measured."""
    while True:
        counts = client.get(f"/v1/sessions/{session_id}")["counts"]
        if counts["succeeded"] + counts["failed"] == images:
            return
        time.sleep(POLL_S)


def new_session(client: ServiceClient, target: TargetSpec = TARGET) -> str:
    """Make a target and a session with it; return the session's id."""
    fields = {
        "kind": target.kind,
        "columns": target.columns,
        "rows": target.rows,
        "pitch_mm": target.pitch_mm,
    }
    target_id = client.create("/v1/targets", {"name": "board", **fields})["id"]
    session_id: str = client.create("/v1/sessions", {"name": "bench", "target_ids": [target_id]})["id"]
    return session_id


def _rendered(seeds: list[int], count: int) -> list[UInt8[np.ndarray, "h w"]]:
    return [
        render(standard_scene(TARGET, seeds[number % len(seeds)] * 1000 + number)) for number in range(count)
    ]


def _files(folder: Path, encoded: Sequence[bytes], count: int, first: int) -> list[Path]:
    """Write files that neither service nor reference has yet; variants are numbered from `first`."""
    folder.mkdir(parents=True)
    paths = []
    for number in range(count):
        path = folder / f"{number:04d}"
        path.write_bytes(variant(encoded[number % len(encoded)], first + number))
        paths.append(path)
    return paths


def _prepare() -> None:
    cv2.setNumThreads(1)


def _wait_a_little(_: int) -> None:
    time.sleep(0.5)


def _calibrate(file: Path) -> bool:
    from core import GridposeError

    target = TargetSpec(TARGET.kind, TARGET.columns, TARGET.rows, TARGET.pitch_mm)
    try:
        calibrate_image(file.read_bytes(), target)
    except GridposeError:
        return False
    return True
