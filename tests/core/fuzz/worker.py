"""One process that goes through items by number: `python -m tests.core.fuzz.worker file 17 18 report` repeats item 17.

Each line of the report is one JSON value: the number begun, a finding, or at the end how often each outcome came.
A hang ends the process by a timer of its own processor time, which a busy machine does not shorten, and a runaway
allocation meets a limit of the address space.
"""

from __future__ import annotations

import faulthandler
import itertools
import json
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

import cv2
import numpy as np

from app.errors import InvalidContent, UnsupportedContent
from app.jobs.validation import validate_image
from core.errors import DetectionError, GridposeError, ImageError
from core.image import decode, read_header, tiff
from core.targets import GridPoints, TargetSpec, detect
from tests.core.fuzz.mutated_files import mutated_file, whole_files
from tests.core.fuzz.mutated_lattices import mutated_lattice
from tests.support.image.hostile_headers import hostile_header

LIMIT_S = 2.0
GROWTH_BYTES = 256 << 20
MAX_PIXELS = 1 << 20
HEADER_LIMIT_S = 0.2
HEADER_GROWTH_BYTES = 8 << 20
"""Reading a header happens in the process that serves everybody, decoding in one that may be busy and large."""
_FLAGS = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
_BOARD = TargetSpec("chessboard", 9, 6, pitch_mm=20.0)

Item = Callable[[], str]


def file_item(number: int) -> Item:
    """Decode a damaged file, and look for a board in what comes out."""
    data = mutated_file(number)

    def run() -> str:
        try:
            image = decode(data, max_pixels=MAX_PIXELS)
        except ImageError as error:
            return error.code
        header = read_header(data)
        assert image.shape == (header.height_px, header.width_px)
        assert image.dtype in (np.uint8, np.uint16)
        assert image.flags.c_contiguous
        assert image.flags.writeable
        stored = tiff.unturned(memoryview(data)) if header.format == "tiff" else data  # OpenCV obeys the tag
        reference = cv2.imdecode(np.frombuffer(stored, np.uint8), _FLAGS)
        if (
            reference is None
        ):  # strips of 2^32 - 1 rows, the standard's way to say all, are too many for OpenCV
            assert header.format in ("tiff", "bmp"), "OpenCV refuses this file"
        else:
            assert np.array_equal(image, reference), "OpenCV decodes other pixels"
        return "decoded, " + _outcome(image, _BOARD)

    return run


def header_item(number: int) -> Item:
    """Admit a file with a hostile header as the HTTP process does, and decode it as a worker does."""
    data = hostile_header(number)

    def run() -> str:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "upload")
            path.write_bytes(data)
            _forget_peak()
            began_s, began_bytes = time.process_time(), _peak_bytes()
            try:
                validate_image(path, MAX_PIXELS)
                outcome = "admitted, "
            except (InvalidContent, UnsupportedContent):
                outcome = "refused, "
            took_s, took_bytes = time.process_time() - began_s, _peak_bytes() - began_bytes
        assert took_s < HEADER_LIMIT_S, f"the header took {took_s:.2f} s of processor time"
        assert took_bytes < HEADER_GROWTH_BYTES, f"the header took {took_bytes >> 20} MiB"
        try:
            image = decode(data, max_pixels=MAX_PIXELS)
        except ImageError as error:
            return outcome + error.code
        assert outcome == "admitted, "
        header = read_header(data)
        assert image.shape == (header.height_px, header.width_px)
        return outcome + "decoded"

    return run


def lattice_item(number: int) -> Item:
    """Look for a board in a mutated image of boards."""
    image, target = mutated_lattice(number)
    return lambda: _outcome(image, target)


def planted_item(number: int) -> Item:
    """Do what the watch must see: 1 fails, 2 hangs, 3 crashes, 4 takes memory, 5 hangs without working."""

    def run() -> str:
        if number == 1:
            raise ValueError("planted")
        while number == 2:
            pass
        if number == 3:
            faulthandler.disable()
            os.kill(os.getpid(), signal.SIGSEGV)
        if number == 4:
            return f"took {np.ones(GROWTH_BYTES + (64 << 20), np.uint8).nbytes}"
        if number == 5:
            signal.pause()
        return "nothing"

    return run


def _outcome(image: np.ndarray, target: TargetSpec) -> str:
    try:
        points = detect(image, target)
    except DetectionError as error:
        return error.code
    _check(points, image, target)
    return "found"


def _check(points: GridPoints, image: np.ndarray, target: TargetSpec) -> None:
    height, width = image.shape
    assert points.target == target
    assert 0 < len(points) <= target.size
    assert points.points_px.shape == (len(points), 2)
    assert points.standard_uncertainty_px.shape == points.column.shape == points.row.shape == (len(points),)
    assert np.all((points.column >= 0) & (points.column < target.columns))
    assert np.all((points.row >= 0) & (points.row < target.rows))
    assert len(set(zip(points.row.tolist(), points.column.tolist(), strict=True))) == len(points)
    assert np.all(np.isfinite(points.points_px))
    assert np.all((points.points_px >= -0.5) & (points.points_px <= (width - 0.5, height - 0.5)))
    assert np.all(np.isfinite(points.standard_uncertainty_px))
    assert np.all(points.standard_uncertainty_px > 0)
    lattice = np.full((target.rows, target.columns, 2), np.nan)
    lattice[points.row, points.column] = points.points_px
    for along in (lattice, lattice.transpose(1, 0, 2)):
        spacing = np.linalg.norm(along[2:] - along[:-2], axis=2) / 2
        from_the_middle = np.linalg.norm(along[1:-1] - (along[2:] + along[:-2]) / 2, axis=2)
        assert not np.any(from_the_middle > spacing / 2), "a grid point is half a square from its place"
    apart = np.linalg.norm(points.points_px[:, None] - points.points_px[None], axis=2)
    assert np.all(apart[np.triu_indices(len(points), 1)] > 1.0), "two grid points at one place"


_KINDS: dict[str, Callable[[int], Item]] = {
    "file": file_item,
    "header": header_item,
    "lattice": lattice_item,
    "planted": planted_item,
}


def _warm_up(kind: str) -> None:
    """Load and compile what the items use, so that none of them pays for it."""
    for data in whole_files().values():
        whole = decode(data)
        if kind == "header":
            continue
        for image in (whole, cv2.resize(whole, (480, 360), interpolation=cv2.INTER_NEAREST)):
            try:
                detect(image, _BOARD)
            except GridposeError:
                continue
    for number in range(30):
        _KINDS[kind if kind == "header" else "lattice"](number)()


def _forget_peak() -> None:
    """Make what this process has now the most it had."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def _peak_bytes() -> int:
    """Return the most memory this process had: getrusage would begin with what its parent had."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * int(status.split("VmHWM:")[1].split()[0])


def main(kind: str, begin: int, end: int, report: TextIO) -> None:
    """Go through the items from `begin` to before `end`."""
    cv2.setNumThreads(1)
    if kind != "planted":
        _warm_up(kind)
    address_space = (
        int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    )
    resource.setrlimit(resource.RLIMIT_AS, (address_space + 4 * GROWTH_BYTES,) * 2)
    outcomes: Counter[str] = Counter()

    def write(value: object) -> None:
        print(json.dumps(value), file=report, flush=True)

    most = _peak_bytes()
    for number in itertools.islice(itertools.count(begin), end - begin):
        item = _KINDS[kind](number)
        write(number)
        signal.setitimer(signal.ITIMER_PROF, LIMIT_S)  # its signal is not handled: it ends the process
        try:
            outcomes[item()] += 1
        except Exception:  # noqa: BLE001 - whatever comes out that should not is what is looked for
            write({"number": number, "finding": traceback.format_exc()})
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        now = _peak_bytes()
        if now - most > GROWTH_BYTES:
            write({"number": number, "finding": f"the process grew by {(now - most) >> 20} MiB"})
        most = max(most, now)
    write({"outcomes": outcomes})


if __name__ == "__main__":
    faulthandler.enable()
    with open(sys.argv[4], "w", encoding="utf-8") as lines:  # noqa: PTH123 - line by line, while it runs
        main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), lines)
