"""Checks of versions, libraries and workers."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version

import cv2
import numpy as np

from app.build import core_version
from app.records.database import sqlite_driver, sqlite_version
from app.records.file_lock import AlreadyLocked, FileLock
from app.services.inspection.check_result import CheckResult, failed, ok, warn
from app.settings import Settings, unknown_settings

_PACKAGES = ("fastapi", "uvicorn", "sqlalchemy", "numpy", "scipy")


def check_installation() -> Iterator[CheckResult]:
    """Check versions, OpenCV and SQLite."""
    yield ok(f"gridpose {core_version()}, Python {platform.python_version()}, {platform.platform()}")
    yield ok(", ".join(f"{name} {_version(name)}" for name in _PACKAGES))
    yield _opencv()
    yield _sqlite()


def check_variables() -> Iterator[CheckResult]:
    """Check that every variable of ours in the environment is one that something reads."""
    for name, nearest in unknown_settings(os.environ):
        yield warn(
            f"{name} is no setting, and is ignored",
            f"{f'Is {nearest} meant? ' if nearest else ''}docs/configuration.md lists the settings.",
        )


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"


def _opencv() -> CheckResult:
    """Encode and decode an image in every accepted format."""
    image = np.arange(64 * 48, dtype=np.uint8).reshape(48, 64)
    broken = []
    for suffix in (".png", ".tiff", ".bmp", ".jpg"):
        try:
            _, data = cv2.imencode(suffix, image)
            read = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
        except cv2.error:
            read = None
        if read is None or read.shape != image.shape:
            broken.append(suffix)
    if broken:
        return failed(
            f"OpenCV {cv2.__version__} cannot read {', '.join(broken)}",
            "Install opencv-python-headless as in requirements.txt, and no other OpenCV alongside it.",
        )
    return ok(f"OpenCV {cv2.__version__} reads PNG, TIFF, BMP and JPEG")


def _sqlite() -> CheckResult:
    _, bundled = sqlite_driver()
    number, has_fix = sqlite_version()
    source = "pysqlite3" if bundled else "Python's own"
    if has_fix:
        return ok(f"SQLite {number} ({source})")
    return warn(
        f"SQLite {number} ({source}) has the WAL-reset bug of 3.7.0 to 3.51.2, which can lose commits",
        "Install pysqlite3 (it brings a newer SQLite), a newer Python, or use PostgreSQL.",
    )


def check_workers(settings: Settings) -> Iterator[CheckResult]:
    """Check the number of workers, and whether a service or worker runs."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    count = settings.worker_count
    if count == 0:
        yield warn("GRIDPOSE_WORKERS=0: `serve` computes nothing", "Run `gridpose worker` alongside it.")
    elif count > cores:
        yield warn(
            f"{count} workers on {cores} cores",
            "More workers than cores gain nothing; lower GRIDPOSE_WORKERS.",
        )
    else:
        yield ok(f"{count} workers on {cores} cores")
    runs = _is_running(settings)
    if runs is None:
        yield warn(
            "whether a service or a worker runs is not known: runner.lock is closed to this user",
            "Run this as the user that the service runs as; the checks of the data folder name the owner.",
        )
        return
    yield ok("a service or worker is running on this folder" if runs else "nothing runs on this folder")


def _is_running(settings: Settings) -> bool | None:
    path = settings.data_dir / "runner.lock"
    if not path.exists():
        return False
    lock = FileLock(path)
    try:
        lock.acquire()
    except AlreadyLocked:
        return True
    except PermissionError:
        return None
    except OSError:  # e.g. a disk that is read-only now: no process can hold a lock on it
        return False
    lock.release()
    return False
