"""Versions, and whether the image library works."""

from __future__ import annotations

import platform
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version

import cv2
import numpy as np

from app.cli.findings import Finding, failed, ok, warn
from app.records.database import sqlite_driver, sqlite_version

_SHOWN = ("fastapi", "uvicorn", "sqlalchemy", "pebble", "numpy", "scipy")


def examine() -> Iterator[Finding]:
    yield ok(f"gridpose {version('gridpose')}, Python {platform.python_version()}, {platform.platform()}")
    yield ok(", ".join(f"{name} {_version(name)}" for name in _SHOWN))
    yield _opencv()
    yield _sqlite()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"


def _opencv() -> Finding:
    """Write and read a picture in every format that is taken."""
    picture = np.arange(64 * 48, dtype=np.uint8).reshape(48, 64)
    broken = []
    for suffix in (".png", ".tiff", ".bmp", ".jpg"):
        try:
            _, data = cv2.imencode(suffix, picture)
            read = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
        except cv2.error:
            read = None
        if read is None or read.shape != picture.shape:
            broken.append(suffix)
    if broken:
        return failed(
            f"OpenCV {cv2.__version__} cannot read {', '.join(broken)}",
            "Install opencv-python-headless as requirements.txt has it, and no other OpenCV beside it.",
        )
    return ok(f"OpenCV {cv2.__version__} reads PNG, TIFF, BMP and JPEG")


def _sqlite() -> Finding:
    _, bundled = sqlite_driver()
    number, has_fix = sqlite_version()
    source = "pysqlite3" if bundled else "Python's own"
    if has_fix:
        return ok(f"SQLite {number} ({source})")
    return warn(
        f"SQLite {number} ({source}) has the WAL-reset bug of 3.7.0 to 3.51.2, which can lose commits",
        "Install pysqlite3 (it brings a newer SQLite), a newer Python, or use PostgreSQL.",
    )
