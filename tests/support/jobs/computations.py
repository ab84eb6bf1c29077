"""What workers of test runners do. A worker process imports this module, so it imports little itself."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from app.jobs import worker_init
from app.jobs.queue import Job
from app.records.outcome import Failure, Outcome

DONE = Outcome(result=None, failure=Failure("target_not_found", "Nothing there.", None))


def compute_by_name(_job: Job, path: str, _max_pixels: int) -> tuple[Outcome, float]:
    """Die (K), wait after SIGTERM (T), hang (H), hang once (O), wait for a marker (W), raise (R, M, E), or end well."""
    order, marker = Path(path).read_bytes()[-1:], Path(path + ".mark")
    if order == b"K":
        os.kill(os.getpid(), signal.SIGKILL)
    if order == b"T":
        os.kill(os.getpid(), signal.SIGTERM)
        signal.pause()
    if order == b"H":
        signal.pause()
    if order == b"O" and not marker.exists():  # only the first time
        marker.touch()
        signal.pause()
    if order == b"W":
        while not marker.exists():
            time.sleep(0.01)
    if order == b"R":
        raise RuntimeError("a defect")
    if order == b"M":
        raise MemoryError
    if order == b"E":
        raise OSError(24, "Too many open files")
    return DONE, 1.0


def start_without_warm_up(max_image_pixels: int, tied_to_thread: bool) -> None:
    """Initialise a worker that measures no image: all of `start_worker` but its first image, which takes seconds."""
    worker_init.end_with_parent(use_death_signal=tied_to_thread)
    worker_init.prepare_environment(max_image_pixels)


def start_after(gate: str, max_image_pixels: int, tied_to_thread: bool) -> None:
    """Initialise a worker that is not ready before the file `gate` is there."""
    while not Path(gate).exists():
        time.sleep(0.01)
    start_without_warm_up(max_image_pixels, tied_to_thread)
