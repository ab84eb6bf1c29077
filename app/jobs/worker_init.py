"""Start of a worker process: one thread, and an end when its parent ends.

This module imports nothing heavy, so that the environment is set before numpy and OpenCV are loaded.
"""

from __future__ import annotations

import ctypes
import gc
import multiprocessing
import os
import signal
import sys
import threading
from pathlib import Path

from app.threads import limit_threads

THUMBNAIL_NICENESS = 10
"""A tenth of a processor while workers have work, all of it while they have none."""
_PR_SET_PDEATHSIG = 1
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_HEAP_BLOCK_BYTES = 32 << 20
"""Blocks up to this size come from the heap; larger ones, as for 20 Mpx in colour, go back to the system at once."""
_KEPT_BYTES = 128 << 20
"""How much freed memory the heap keeps for the next image; one of 5 Mpx takes less."""


def prepare_environment(max_image_pixels: int) -> None:
    """Set what children inherit and must see before they import numpy or OpenCV."""
    limit_threads()
    os.environ["OPENCV_IO_MAX_IMAGE_PIXELS"] = str(max_image_pixels)


def keep_compiled_code(data_dir: Path) -> None:
    """Let children keep compiled kernels in the data folder where the program's own may not be written.

    What an installation compiled is read where it lies; this is the place of the rest, such as the code for another
    processor than the installation's, which every worker that starts would compile again, many seconds each.

    There, home and temporary folders may not be written either, without which matplotlib draws nothing: it keeps its
    list of fonts in the data folder, too.
    """
    if not os.access(Path(__file__).parents[2] / "core", os.W_OK):
        os.environ.setdefault("NUMBA_CACHE_DIR", str(data_dir / "compiled"))
        os.environ.setdefault("MPLCONFIGDIR", str(data_dir / "compiled" / "matplotlib"))


def start_worker(max_image_pixels: int, tied_to_thread: bool) -> None:
    """Initialise a worker that measures: as `start_drawing`, and load the numerics before the first job."""
    start_drawing(max_image_pixels, tied_to_thread)
    gc.disable()  # what is loaded stays to the end: nothing of it is garbage

    import app.jobs.process_image  # noqa: F401 - loaded here so that the first job need not
    from app.jobs.warm_up import warm_up

    warm_up()
    gc.freeze()
    gc.enable()


def start_drawing(max_image_pixels: int, tied_to_thread: bool) -> None:
    """Initialise a worker that decodes images and draws: tie it to its parent, and limit threads.

    `tied_to_thread`: the thread that starts this process lives as long as the pool does, which Linux's death signal
    needs, since it fires at the end of that thread.
    """
    end_with_parent(use_death_signal=tied_to_thread)
    keep_freed_memory()
    prepare_environment(max_image_pixels)

    import cv2

    cv2.setNumThreads(1)


def start_thumbnails(max_image_pixels: int, tied_to_thread: bool) -> None:
    """Initialise a worker that draws thumbnails: as `start_drawing`, and after all others where processors are short.

    A page that shows images as they come asks for as many thumbnails as are measured, and each takes half of what its
    measurement takes. A first one loads what all of them need before that: on a busy machine this second would be a
    minute, and count as the time that one thumbnail may take.
    """
    start_drawing(max_image_pixels, tied_to_thread)

    import cv2
    import numpy as np

    from app.reports.overlay import THUMBNAIL_PX, draw_thumbnail
    from core.image import decode_preview

    _, encoded = cv2.imencode(".png", np.zeros((8, 8), np.uint8))
    first = decode_preview(encoded.tobytes(), longest_side_px=THUMBNAIL_PX, max_pixels=64)
    draw_thumbnail(first.grey)
    if hasattr(os, "nice"):
        os.nice(THUMBNAIL_NICENESS)


def keep_freed_memory() -> None:
    """Let the allocator keep what an image leaves for the next one, where it is glibc's.

    Given back and asked for again, every page is zeroed at its first touch: 1,400 page faults a JPEG of 5 Mpx, 10 % of
    its processor time.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _HEAP_BLOCK_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)


def end_with_parent(*, use_death_signal: bool) -> None:
    """Make sure that this process ends when its parent does, even by SIGKILL.

    A thread that waits for the parent works everywhere but needs the interpreter; on Linux the kernel's death signal
    ends even a process stuck in a long call.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    if use_death_signal and sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent.pid:  # it died before we asked
            os._exit(1)

    def wait_for_end() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait_for_end, name="parent-watch", daemon=True).start()
