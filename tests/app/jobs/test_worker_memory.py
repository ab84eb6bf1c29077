"""What the allocator of a worker process keeps between images."""

from __future__ import annotations

import ctypes
import sys

import cv2
import numpy as np
import pytest

from app.jobs.worker_init import start_drawing
from app.jobs.worker_process import WorkerProcess

WITHIN_S = 60.0
IMAGES = 10
MAX_PIXELS = 10_000_000
PAGES_OF_AN_IMAGE = 3 * 2448 * 2048 // 4096
M_MMAP_THRESHOLD = -3


@pytest.mark.skipif(sys.platform != "linux", reason="page faults are counted on Linux")
def test_a_worker_that_decodes_images_asks_the_system_for_memory_once() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (2048 // 16, 2448 // 16, 3), dtype=np.uint8)
    data = cv2.imencode(".jpg", cv2.resize(picture, (2448, 2048)))[1].tobytes()
    process = WorkerProcess(start_drawing, (MAX_PIXELS, False))
    try:
        process.greeting.result(WITHIN_S)
        kept = process.schedule(_faults_of_an_image, data).result(WITHIN_S)
        process.schedule(_give_back).result(WITHIN_S)
        given_back = process.schedule(_faults_of_an_image, data).result(WITHIN_S)
    finally:
        process.end()
    assert kept < PAGES_OF_AN_IMAGE / 20
    assert given_back > PAGES_OF_AN_IMAGE / 2, "else nothing is counted here"


def _give_back() -> None:
    """Let the allocator give back each image, as it does with large blocks before any was freed."""
    assert ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, 128 << 10)


def _faults_of_an_image(data: bytes) -> float:
    """Return how many pages of memory were touched for the first time, the mean over images after the first."""
    import resource

    encoded = np.frombuffer(data, np.uint8)
    cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(IMAGES):
        cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    return (resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) / IMAGES
