"""What a worker process is given at its start: memory that it keeps between images, and its place in the queue."""

from __future__ import annotations

import ctypes
import os
import sys

import pytest

from app.jobs.worker_init import THUMBNAIL_NICENESS, start_drawing, start_thumbnails
from app.jobs.worker_process import WorkerProcess

WITHIN_S = 60.0
BLOCKS, BLOCK_BYTES = 4, 5 << 20
"""What decoding an image of 5 Mpx takes, about."""


@pytest.mark.skipif(sys.platform != "linux", reason="page faults are counted on Linux")
def test_a_worker_asks_the_system_for_an_images_memory_once() -> None:
    assert _faults_after(WorkerProcess(start_drawing, (10_000_000, False))) < 1.0
    assert _faults_after(WorkerProcess(_nothing, ())) > 5.0, "else nothing is counted here"


@pytest.mark.skipif(not hasattr(os, "nice"), reason="Windows has no niceness")
def test_thumbnails_are_drawn_after_all_else() -> None:
    process = WorkerProcess(start_thumbnails, (10_000_000, False))
    try:
        process.greeting.result(WITHIN_S)
        niceness: int = process.schedule(os.nice, 0).result(WITHIN_S)
    finally:
        process.end()
    assert niceness == min(os.nice(0) + THUMBNAIL_NICENESS, 19)


def _nothing() -> None:
    """Leave the allocator as it is."""


def _faults_after(process: WorkerProcess) -> float:
    try:
        process.greeting.result(WITHIN_S)
        faults: float = process.schedule(_faults_of_an_image).result(WITHIN_S)
    finally:
        process.end()
    return faults


def _faults_of_an_image() -> float:
    """Return how many pages of memory were touched for the first time, the mean over ten images after the first two."""
    import resource

    libc = ctypes.CDLL(None)
    libc.malloc.restype = ctypes.c_void_p
    libc.malloc.argtypes = [ctypes.c_size_t]
    libc.free.argtypes = [ctypes.c_void_p]

    def use() -> None:
        blocks = [libc.malloc(BLOCK_BYTES) for _ in range(BLOCKS)]
        for block in blocks:
            ctypes.memset(block, 1, BLOCK_BYTES)
        for block in reversed(blocks):
            libc.free(block)

    use()
    use()  # by the first one the allocator learns the size of blocks
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(10):
        use()
    return (resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) / 10
