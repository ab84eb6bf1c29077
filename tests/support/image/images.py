"""Images that tests send to the service."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np


def encode(extension: str, image: Any, *options: int) -> bytes:
    """Return an array as a file of the format its extension names."""
    encoded, buffer = cv2.imencode(extension, image, options)
    assert encoded
    return bytes(buffer)


def small_image(number: int) -> bytes:
    """A PNG file of a few hundred bytes that shows no grid, another one for each number."""
    return encode(".png", np.random.default_rng(number).integers(0, 256, (8, 24), dtype=np.uint8))


@cache
def slow_image() -> bytes:
    """A progressive JPEG of noise: a few MB that take seconds to decode, and tens of MB of memory."""
    tile = np.random.default_rng(5).integers(0, 256, (1000, 1000), dtype=np.uint8)
    options = (cv2.IMWRITE_JPEG_QUALITY, 40, cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
    return encode(".jpg", np.tile(tile, (9, 10)), *options)


def flip_bit(path: Path) -> None:
    """Change one bit in the middle of a file, as a failing disk does; its length and times stay."""
    times = path.stat()
    with path.open("r+b") as file:
        file.seek(times.st_size // 2)
        (byte,) = file.read(1)
        file.seek(-1, os.SEEK_CUR)
        file.write(bytes([byte ^ 0x10]))
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
