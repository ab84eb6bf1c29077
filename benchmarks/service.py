"""Throughput and latency of the service, compared with a bare loop over the same files and a bare write."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import struct
import tempfile
import time
import zlib
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from statistics import median

import cv2
import numpy as np

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from benchmarks.table import Row
from core import TargetSpec, calibrate_image
from core.simulation import render, standard_scene, standard_target

TARGET = standard_target(14, 10)
POLL_S = 0.25  # a question costs the head some milliseconds; asked often it would measure itself


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    encoded = _encoded_images(seeds, 3 if quick else 12)
    images, repeats = (24, 2) if quick else (72, 5)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    yield from _throughput(encoded, images, repeats, cores)
    yield from _acknowledgement(40 if quick else 400)


def _throughput(encoded: Sequence[bytes], images: int, repeats: int, cores: int) -> Iterable[Row]:
    """Time, in turns: the bare loop, the service with as many workers, and the service with one."""
    bare: list[float] = []
    service: dict[int, list[float]] = {cores: [], 1: []}
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        folder = Path(name)
        with ProcessPoolExecutor(cores, multiprocessing.get_context("spawn"), _prepare) as pool:
            list(pool.map(_wait_a_little, range(cores)))  # all of them started and loaded
            for repeat in range(repeats):
                files = _files(folder / f"files-{repeat}", encoded, images)
                started = time.perf_counter()
                done = list(pool.map(_calibrate, files))
                bare.append(images / (time.perf_counter() - started))
                assert sum(done) > images / 2, "most of these images can be calibrated"
                for workers, rates in service.items():
                    rates.append(_service_rate(folder / f"data-{repeat}-{workers}", files, workers))
    ratio = median(s / b for s, b in zip(service[cores], bare, strict=True))
    note = f"{images} images of 5 Mpx, 14x10, {repeats} times in turns, medians"
    yield Row.context(f"bare loop, {cores} processes", median(bare), "images/s", note)
    yield Row.context(f"HTTP, upload to result, {cores} workers", median(service[cores]), "images/s", note)
    yield Row.at_least(
        "HTTP images/s ÷ bare loop with as many processes", ratio, 0.85, note="client on the same cores"
    )
    if cores > 1:
        gain = median(n / one for n, one in zip(service[cores], service[1], strict=True))
        yield Row.at_least(
            f"{cores} workers ÷ 1, by HTTP", gain, 0.95 * cores, note="client on the same cores"
        )


def _acknowledgement(uploads: int) -> Iterable[Row]:
    """Time, in turns: a write with fsync of a 3 MB file, and the answer to its upload; nothing else runs."""
    size = (1730, 1730)
    png = cv2.imencode(".png", np.random.default_rng(3).integers(0, 256, size, dtype=np.uint8))[1].tobytes()
    writes, answers = [], []
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        folder = Path(name)
        with (
            ServiceProcess(folder / "data", {"GRIDPOSE_WORKERS": "0"}) as service,
            ServiceClient(service.url, service.admin_key) as client,
        ):
            session_id = _new_session(client)
            for number in range(uploads + 10):
                data = _variant(png, number)
                sha256 = hashlib.sha256(data).hexdigest()
                started = time.perf_counter()
                with (folder / "bare").open("wb") as file:
                    file.write(data)
                    file.flush()
                    os.fsync(file.fileno())
                written = time.perf_counter()
                client.put_image(session_id, "P1", sha256, data)
                writes.append(written - started)
                answers.append(time.perf_counter() - written)
    writes, answers = writes[10:], answers[10:]  # the first ones warm connections and caches
    p99, write_p99 = np.quantile(answers, 0.99), np.quantile(writes, 0.99)
    note = f"{uploads} uploads of {len(png) / 1e6:.1f} MB, in turns"
    yield Row.context(
        "write + fsync of 3 MB, median; p99", 1000 * median(writes), "ms", f"p99 {1000 * write_p99:.1f} ms"
    )
    yield Row.context(
        "acknowledgement of 3 MB, median; p99", 1000 * median(answers), "ms", f"p99 {1000 * p99:.1f} ms"
    )
    yield Row.at_most("acknowledgement p99 ÷ write + fsync p99", p99 / write_p99, 3, note=note)
    yield Row.context(
        "acknowledgement median ÷ write + fsync median", median(answers) / median(writes), note=note
    )


def _service_rate(data_dir: Path, files: Sequence[Path], workers: int) -> float:
    with (
        ServiceProcess(data_dir, {"GRIDPOSE_WORKERS": str(workers)}) as service,
        ServiceClient(service.url, service.admin_key) as client,
    ):
        session_id = _new_session(client)
        _warm_up(client, files[0], workers)

        def send(file: Path) -> None:
            data = file.read_bytes()
            client.put_image(session_id, "P1", hashlib.sha256(data).hexdigest(), data)

        started = datetime.now(UTC)
        with ThreadPoolExecutor(2) as pool:
            for future in [pool.submit(send, file) for file in files]:
                future.result()
        _await_all(client, session_id, len(files))
        # The service says when the last result was stored, more exactly than asking now and then could.
        listed = list(client.items(f"/v1/sessions/{session_id}/measurements"))
        last = max(datetime.fromisoformat(item["finished_at"]) for item in listed)
        assert len(listed) == len(files)
        return len(files) / (last - started).total_seconds()


def _warm_up(client: ServiceClient, file: Path, workers: int) -> None:
    session_id = _new_session(client)
    for number in range(4 * workers):
        data = _variant(file.read_bytes(), 10_000 + number)
        client.put_image(session_id, "P1", hashlib.sha256(data).hexdigest(), data)
    _await_all(client, session_id, 4 * workers)


def _await_all(client: ServiceClient, session_id: str, images: int) -> None:
    while True:
        counts = client.get(f"/v1/sessions/{session_id}")["counts"]
        if counts["succeeded"] + counts["failed"] == images:
            return
        time.sleep(POLL_S)


def _new_session(client: ServiceClient) -> str:
    target = {
        "kind": TARGET.kind,
        "columns": TARGET.columns,
        "rows": TARGET.rows,
        "pitch_mm": TARGET.pitch_mm,
    }
    target_id = client.create("/v1/targets", {"name": "board", **target})["id"]
    session_id: str = client.create("/v1/sessions", {"name": "bench", "target_ids": [target_id]})["id"]
    return session_id


def _encoded_images(seeds: list[int], count: int) -> list[bytes]:
    encoded = []
    for number in range(count):
        scene = standard_scene(TARGET, seeds[number % len(seeds)] * 1000 + number)
        encoded.append(cv2.imencode(".png", render(scene))[1].tobytes())
    return encoded


def _files(folder: Path, encoded: Sequence[bytes], count: int) -> list[Path]:
    folder.mkdir(parents=True)
    paths = []
    for number in range(count):
        path = folder / f"{number:04d}.png"
        path.write_bytes(_variant(encoded[number % len(encoded)], number))
        paths.append(path)
    return paths


def _variant(png: bytes, number: int) -> bytes:
    """Return the same image as a file of another hash: with a comment after its header chunk."""
    body = b"tEXtComment\x00" + str(number).encode()
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return png[:33] + chunk + png[33:]


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
