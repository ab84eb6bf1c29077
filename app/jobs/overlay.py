"""The picture of one measurement: the original, the points found, and their residuals, drawn in a worker process."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from app.errors import Conflict, Unavailable
from app.jobs.side_process import Crowded, Lost, SideProcess, TimedOut

TIMEOUT_S = 30.0
WAITING_AT_MOST = 8
RESIDUAL_SCALE = 100.0
"""Residuals are drawn a hundred times as long as they are; a hundredth of a pixel would not be seen."""
_LONGEST_SIDE_PX = 2400


class OverlayPainter:
    """Draws overlays in a process of its own."""

    def __init__(self, max_pixels: int) -> None:
        self._max_pixels = max_pixels
        self._process = SideProcess(max_pixels, timeout_s=TIMEOUT_S, waiting_at_most=WAITING_AT_MOST)

    def draw(self, path: Path, points: list[dict[str, Any]]) -> bytes:
        """Return a PNG of the image at `path` with `points` (as the API lists them) drawn into it."""
        try:
            drawn = self._process.call(draw_overlay, str(path), points, self._max_pixels)
        except Crowded:
            raise Unavailable(
                "Too many overlays are being drawn.", "Ask again shortly.", code="busy"
            ) from None
        except TimedOut as error:
            raise Unavailable(
                "The overlay could not be drawn in time.", "Ask again when the server is less busy."
            ) from error
        except Lost as error:
            raise Unavailable(
                "The process that drew the overlay ended unexpectedly.",
                "Ask again; if it happens again, the server may be short of memory.",
            ) from error
        if drawn is None:
            raise Conflict(
                "The stored image cannot be decoded, so there is nothing to draw on.",
                "Upload an undamaged image.",
                code="undecodable_image",
            )
        return drawn

    def close(self) -> None:
        """End the process."""
        self._process.close()


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
    # The target's axes, from grid point (0, 0) on: a wrong orientation is seen at a glance.
    at = {(point["column"], point["row"]): place(point["u_px"], point["v_px"]) for point in points}
    for end_of, colour, name in (((2, 0), (0, 0, 255), "x"), ((0, 2), (255, 0, 0), "y")):
        if (0, 0) in at and end_of in at:
            tip = at[end_of]
            cv2.arrowedLine(
                canvas, at[0, 0], tip, colour, max(1, radius // 3), cv2.LINE_AA, subpixel, tipLength=0.1
            )
            corner = ((tip[0] >> subpixel) + radius, (tip[1] >> subpixel) - radius)
            cv2.putText(
                canvas, name, corner, cv2.FONT_HERSHEY_SIMPLEX, radius / 8, colour, max(1, radius // 4)
            )
    _write_legend(canvas, radius)
    encoded, buffer = cv2.imencode(".png", canvas, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert encoded
    return bytes(buffer)


def _write_legend(canvas: Any, radius: int) -> None:
    """Say in the lower left corner what the colours and lines are."""
    import cv2

    text = f"green: used   red: left out   lines: residuals x {RESIDUAL_SCALE:g}"
    size, weight = max(0.35, radius / 14), max(1, radius // 6)
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, weight)
    bottom = canvas.shape[0] - 1
    cv2.rectangle(
        canvas, (0, bottom - height - 2 * below), (width + 2 * below, bottom), (255, 255, 255), cv2.FILLED
    )
    cv2.putText(
        canvas, text, (below, bottom - below), cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), weight, cv2.LINE_AA
    )
