"""The picture of one measurement: the original, the points found, and their residuals, drawn in a worker process."""

from __future__ import annotations

import multiprocessing
import threading
from concurrent.futures import TimeoutError as FutureTimeout
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from pebble import ProcessExpired, ProcessPool

from app.errors import Conflict, Unavailable
from app.jobs.worker_process import prepare_environment, start_worker

TIMEOUT_S = 30.0
WAITING_AT_MOST = 8
RESIDUAL_SCALE = 100.0
"""Residuals are drawn a hundred times as long as they are; a hundredth of a pixel would not be seen."""
_LONGEST_SIDE_PX = 2400
_BUSY = "Too many overlays are being drawn."


class OverlayPainter:
    """Draws overlays in one process of its own, started at the first request and replaced when it dies."""

    def __init__(self, max_pixels: int) -> None:
        self._max_pixels = max_pixels
        self._pool: ProcessPool | None = None
        self._opening = threading.Lock()
        self._places = threading.BoundedSemaphore(WAITING_AT_MOST)

    def draw(self, path: Path, points: list[dict[str, Any]]) -> bytes:
        """Return a PNG of the image at `path` with `points` (as the API lists them) drawn into it."""
        if not self._places.acquire(blocking=False):
            raise Unavailable(_BUSY, "Ask again shortly.", code="busy")
        try:
            future = self._running_pool().schedule(
                draw_overlay, args=(str(path), points, self._max_pixels), timeout=TIMEOUT_S
            )
            drawn: bytes | None = future.result()
        except (FutureTimeout, ProcessExpired, BrokenProcessPool, RuntimeError) as error:
            self._abandon()
            raise Unavailable(
                "The overlay could not be drawn in time.", "Ask again; the server may be short of memory."
            ) from error
        finally:
            self._places.release()
        if drawn is None:
            raise Conflict(
                "The stored image cannot be decoded, so there is nothing to draw on.",
                "Upload an undamaged image.",
                code="undecodable_image",
            )
        return drawn

    def close(self) -> None:
        """End the process."""
        self._abandon()

    def _running_pool(self) -> ProcessPool:
        with self._opening:
            if self._pool is None:
                prepare_environment(self._max_pixels)
                # Not tied to this thread, which serves one request and may end long before the pool.
                self._pool = ProcessPool(
                    max_workers=1,
                    max_tasks=200,
                    initializer=start_worker,
                    initargs=(self._max_pixels, False),
                    context=multiprocessing.get_context("spawn"),
                )
            return self._pool

    def _abandon(self) -> None:
        with self._opening:
            pool, self._pool = self._pool, None
        if pool is not None:
            pool.stop()  # type: ignore[no-untyped-call]
            pool.join()


def draw_overlay(path: str, points: list[dict[str, Any]], max_pixels: int) -> bytes | None:
    """Draw in the worker process: used points green, rejected ones red, undecided ones yellow; None: undecodable."""
    import cv2
    import numpy as np

    from core.errors import ImageError
    from core.image import decode

    try:
        grey = decode(Path(path).read_bytes(), max_pixels=max_pixels)
    except ImageError:
        return None
    if grey.dtype == np.uint16:
        grey = (grey >> 8).astype(np.uint8)
    scale = min(1.0, _LONGEST_SIDE_PX / max(grey.shape))
    if scale < 1.0:
        size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    canvas = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    radius = max(3, round(max(grey.shape) / 300))
    subpixel = 4  # bits of fraction in the coordinates below

    def place(u_px: float, v_px: float) -> tuple[int, int]:
        # (0, 0) is the centre of the top-left pixel before and after scaling.
        fraction = 1 << subpixel
        return (
            round(((u_px + 0.5) * scale - 0.5) * fraction),
            round(((v_px + 0.5) * scale - 0.5) * fraction),
        )

    for point in points:
        colour = {True: (0, 200, 0), False: (0, 0, 255), None: (0, 220, 220)}[point["used"]]
        u, v = point["u_px"], point["v_px"]
        cv2.circle(canvas, place(u, v), radius << subpixel, colour, 1, cv2.LINE_AA, subpixel)
        if point["residual_u_px"] is not None:
            end = place(
                u + RESIDUAL_SCALE * point["residual_u_px"], v + RESIDUAL_SCALE * point["residual_v_px"]
            )
            cv2.line(canvas, place(u, v), end, (255, 128, 0), 1, cv2.LINE_AA, subpixel)
    encoded, buffer = cv2.imencode(".png", canvas, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert encoded
    return bytes(buffer)
