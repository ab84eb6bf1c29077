"""Decoding by kind of file, compared with OpenCV's for identical pixels; and the memory one worker takes."""

from __future__ import annotations

import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Iterable
from pathlib import Path
from statistics import median

import cv2
import numpy as np

from benchmarks.conditions import one_core, seconds, standard_scenes
from benchmarks.table import Row
from core.image import decode
from core.simulation import render

FLAGS = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
AVERAGE, PAETH = 3, 4
"""Filter types of PNG rows."""
PEAK = """
import sys
from pathlib import Path
from app.jobs.worker_init import start_worker
start_worker(30_000_000, False)
from core import TargetSpec, calibrate_image
from core.errors import FocalNotObservable
try:
    calibrate_image(Path(sys.argv[1]).read_bytes(), TargetSpec("chessboard", 14, 10, 21.4))
except FocalNotObservable:
    pass  # all of the work was done
# not ru_maxrss, which a process inherits from the one that started it
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    images = [render(scene) for scene in standard_scenes(seeds, [(14, 10)], 1 if quick else 3)]
    repeats = 3 if quick else 15
    goals = {"PNG": 0.5, "PNG, Average filter": 0.5, "PNG, Paeth filter": 0.5, "BMP": 1.0, "TIFF": 1.0}
    encoded = {kind: [_encode(kind, image) for image in images] for kind in (*goals, "JPEG q95")}
    ours: dict[str, list[float]] = {kind: [] for kind in encoded}
    theirs: dict[str, list[float]] = {kind: [] for kind in encoded}
    with one_core():
        for kind, files in encoded.items():
            for data, image in zip(files, images, strict=True):
                assert np.array_equal(decode(data), cv2.imdecode(np.frombuffer(data, np.uint8), FLAGS))
                assert kind.startswith("JPEG") or np.array_equal(decode(data), image)
        for _ in range(repeats):
            for kind, files in encoded.items():
                for data in files:
                    ours[kind].append(seconds(lambda d=data: decode(d)))
                    array = np.frombuffer(data, np.uint8)
                    theirs[kind].append(seconds(lambda a=array: cv2.imdecode(a, FLAGS)))
    note = f"2448x2050 grey, {len(images)} images × {repeats}, in turns, one core, medians; equal pixels"
    for kind in encoded:
        yield Row.context(f"{kind}", 1e3 * median(ours[kind]), "ms", note)
        ratio = median(ours[kind]) / median(theirs[kind])
        if kind in goals:
            yield Row.at_most(f"{kind} ÷ cv2.imdecode", ratio, goals[kind], note=note)
        else:
            yield Row.context(f"{kind} ÷ cv2.imdecode", ratio, note="OpenCV decodes; ours adds the checks")
    yield from _memory(seeds[0])


def _memory(seed: int) -> Iterable[Row]:
    """Peak memory of a process that starts as a worker does and calibrates one image of 20 Mpx."""
    if sys.platform != "linux":
        return
    scene = next(standard_scenes([seed], [(14, 10)], 1))
    image = cv2.resize(render(scene), (5472, 3648), interpolation=cv2.INTER_LINEAR)
    for kind in ("PNG", "JPEG q95"):
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "image"
            file.write_bytes(_encode(kind, image))
            done = subprocess.run(
                [sys.executable, "-c", PEAK, str(file)], check=True, capture_output=True, text=True
            )
        note = "a fresh process started as a worker: interpreter, libraries, kernels, one image from bytes to pose"
        yield Row.at_most(
            f"memory of one worker at 20 Mpx, {kind}", int(done.stdout) / 1024, 250.0, "MiB", note
        )


def _encode(kind: str, image: np.ndarray) -> bytes:
    """Return a file of that kind; the raw ones and the filtered PNG made here, since OpenCV leaves no choice."""
    if kind == "PNG":
        return cv2.imencode(".png", image)[1].tobytes()
    if kind.startswith("JPEG"):
        return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(kind[6:])])[1].tobytes()
    if kind == "BMP":
        return cv2.imencode(".bmp", image)[1].tobytes()
    if kind == "TIFF":
        return cv2.imencode(".tiff", image, [cv2.IMWRITE_TIFF_COMPRESSION, 1])[1].tobytes()
    return _filtered_png(image, AVERAGE if "Average" in kind else PAETH)


def _filtered_png(image: np.ndarray, kind: int) -> bytes:
    """Return a PNG whose rows all have one filter, as the software of many cameras writes them."""
    height, width = image.shape
    padded = np.pad(image.astype(np.int16), ((1, 0), (1, 0)))
    left, above, corner = padded[1:, :-1], padded[:-1, 1:], padded[:-1, :-1]
    estimate = left + above - corner
    to_left, to_above, to_corner = (np.abs(estimate - x) for x in (left, above, corner))
    nearest = np.where(
        (to_left <= to_above) & (to_left <= to_corner), left, np.where(to_above <= to_corner, above, corner)
    )
    predicted = nearest if kind == PAETH else (left + above) // 2
    filtered = np.empty((height, width + 1), dtype=np.uint8)
    filtered[:, 0] = kind
    filtered[:, 1:] = (image - predicted).astype(np.uint8)
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)),
        (b"IDAT", zlib.compress(filtered.tobytes(), 6)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in chunks
    )
