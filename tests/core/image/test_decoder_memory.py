"""What decoding takes in memory, and what reading headers loads: nothing but the image, nothing of the decoders."""

from __future__ import annotations

import struct
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.image.image_encoders import SIGNATURE, chunk, filtered, idats
from tests.support.image.plain_kinds import grey_png, sample_image

IEND = chunk(b"IEND", b"")


MEASURE = """
import sys
from pathlib import Path
from core.image import decode

def peak_bytes():  # getrusage would begin with what the parent had
    return 1024 * int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])

decode(Path(sys.argv[1]).read_bytes())  # loads and compiles what decoding needs
data = Path(sys.argv[2]).read_bytes()
before = peak_bytes()
image = decode(data)
print(peak_bytes() - before, image.nbytes)
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["png", "png16", "bmp", "tif", "bomb"])
def test_memory(kind: str, tmp_path: Path) -> None:
    """Twenty megapixels, and a small image whose stream goes on for 400 MB, take no more than the image."""
    whole = sample_image(100, 100, np.uint16 if kind == "png16" else np.uint8)
    large = np.tile(whole, (40, 50))
    extension = "." + kind[:3]
    options = [cv2.IMWRITE_TIFF_COMPRESSION, 1] if kind == "tif" else []
    if kind == "bomb":
        rows = filtered(whole, [1] * 100)
        packer = zlib.compressobj()
        stream = (
            packer.compress(rows)
            + b"".join(packer.compress(bytes(1 << 20)) for _ in range(400))
            + packer.flush()
        )
        header = chunk(b"IHDR", struct.pack(">IIBBBBB", 100, 100, 8, 0, 0, 0, 0))
        small_file, file = grey_png(whole, [1] * 100), SIGNATURE + header + idats(stream) + IEND
    else:
        small_file, file = (cv2.imencode(extension, image, options)[1].tobytes() for image in (whole, large))
    paths = [tmp_path / "small", tmp_path / "large"]
    for path, content in zip(paths, (small_file, file), strict=True):
        path.write_bytes(content)
    root = str(Path(__file__).parents[3])
    done = subprocess.run(
        [sys.executable, "-c", MEASURE, *map(str, paths)],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    )
    growth, image_bytes = map(int, done.stdout.split())
    assert 0.5 * (image_bytes - (4 << 20)) < growth <= image_bytes + (4 << 20)


@pytest.mark.slow
def test_reading_headers_needs_neither_numba_nor_the_inflater() -> None:
    """The service's front looks at headers and must stay small; the workers decode."""
    program = "import sys, core.image, app.main; print([m for m in ('numba', 'isal') if m in sys.modules])"
    root = str(Path(__file__).parents[3])
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=root, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
