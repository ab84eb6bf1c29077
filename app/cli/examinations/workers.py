"""Whether images will be computed: settings, and whether somebody does so now."""

from __future__ import annotations

import os
from collections.abc import Iterator

from app.cli.findings import Finding, ok, warn
from app.records.lock import AlreadyLocked, FileLock
from app.settings import Settings


def examine(settings: Settings) -> Iterator[Finding]:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    count = settings.worker_count
    if count == 0:
        yield warn("GRIDPOSE_WORKERS=0: `serve` computes nothing", "Run `gridpose worker` beside it.")
    elif count > cores:
        yield warn(
            f"{count} workers on {cores} cores",
            "More workers than cores gain nothing; lower GRIDPOSE_WORKERS.",
        )
    else:
        yield ok(f"{count} workers on {cores} cores")
    yield ok(
        "a service or worker is running on this folder"
        if _is_running(settings)
        else "nothing runs on this folder"
    )


def _is_running(settings: Settings) -> bool:
    path = settings.data_dir / "runner.lock"
    if not path.exists():
        return False
    lock = FileLock(path)
    try:
        lock.acquire()
    except (AlreadyLocked, PermissionError):
        return True
    except OSError:  # a disk that is read-only now: nobody can have taken the lock on it
        return False
    lock.release()
    return False
