"""What an application's blob store holds, and an image that claims to be too large for it."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

from tests.support.image.image_encoders import SIGNATURE, chunk


def files_of(api: Any) -> list[Path]:
    """Everything in the blob store but folders."""
    return [path for path in api.installation.blobs.root.rglob("*") if path.is_file()]


def bomb(width: int, height: int) -> bytes:
    """A PNG whose header states far more pixels than its bytes hold."""

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    pixels = zlib.compress(b"\0" * 1000)
    return SIGNATURE + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")
