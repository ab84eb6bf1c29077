"""Small images whose results are worth comparing: boards seen from several sides, and some that show none."""

from __future__ import annotations

import zlib
from functools import cache
from typing import Literal

import cv2
import numpy as np

from core import Camera, TargetSpec
from core.geometry.se3 import so3_exp, transform
from core.simulation import Scene, render

BOARD = {"name": "board", "kind": "chessboard", "columns": 7, "rows": 5, "pitch_mm": 10.0}
KINDS = 8
"""Images of different content; upload `n` shows number `n % KINDS`."""
_WITHOUT_BOARD = {5}
_CAMERA = Camera(300.0, 300.0, 159.5, 119.5)
_SIZE_PX = (320, 240)
_PNG_HEADER_BYTES = 33  # signature and IHDR

Form = Literal["png", "bmp"]
"""PNG has a checksum of its own; in BMP a changed bit is a changed pixel, and nothing in the file shows it."""


def image(number: int, form: Form = "png") -> bytes:
    """Return the file of upload `number`: the pixels of its kind, and a number that makes the file unique.

    In PNG the number is a comment; in BMP it is in the reserved bytes of the file header.
    """
    plain = _plain(number % KINDS, form)
    if form == "bmp":
        return plain[:6] + number.to_bytes(4, "little") + plain[10:]
    comment = b"tEXt" + b"Comment\0" + str(number).encode()
    chunk = (len(comment) - 4).to_bytes(4, "big") + comment + zlib.crc32(comment).to_bytes(4, "big")
    return plain[:_PNG_HEADER_BYTES] + chunk + plain[_PNG_HEADER_BYTES:]


@cache
def _plain(kind: int, form: Form) -> bytes:
    if kind in _WITHOUT_BOARD:
        pixels = np.random.default_rng(kind).integers(0, 256, _SIZE_PX[::-1], dtype=np.uint8)
    else:
        tilt = so3_exp(np.array([0.6, 0.08 * kind - 0.3, 0.1 * kind]))
        T_camera_target = transform(tilt, np.array([0.0, 0.0, 120.0]))
        board = TargetSpec("chessboard", 7, 5, pitch_mm=10.0)
        pixels = render(Scene(board, _CAMERA, T_camera_target, *_SIZE_PX, noise_levels=1.5, seed=kind))
    written, data = cv2.imencode(f".{form}", pixels)
    assert written
    return data.tobytes()
