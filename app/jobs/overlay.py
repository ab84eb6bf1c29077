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

    def draw(self, path: Path, points: list[dict[str, Any]], quality: dict[str, Any] | None) -> bytes:
        """Return a PNG of the image at `path` with `points` and capture quality (as the API has them) drawn into it."""
        try:
            drawn = self._process.call(draw_overlay, str(path), points, quality, self._max_pixels)
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


def draw_overlay(
    path: str, points: list[dict[str, Any]], quality: dict[str, Any] | None, max_pixels: int
) -> bytes | None:
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

    if quality is not None:  # before the points, which nothing is to hide
        at_px = [place(point["u_px"], point["v_px"]) for point in points]
        _write_quality(canvas, quality, [(u >> subpixel, v >> subpixel) for u, v in at_px], radius)
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


def quality_lines(quality: dict[str, Any]) -> list[str]:
    """Return what is written of a picture's capture quality: its figures, then its advice."""
    figures = [
        _figure("edges", quality["edge_width_px"], "{:.1f} px"),
        _motion(quality),
        _figure("contrast", quality["contrast"], "{:.0%}"),
        _figure("white saturated", quality["saturated_fraction"], "{:.0%}"),
        _figure("black clipped", quality["clipped_fraction"], "{:.0%}"),
        _figure("fills", quality["coverage_fraction"], "{:.0%} of the picture"),
        _figure("tilt", quality["tilt_deg"], "{:.0f} deg"),
    ]
    advice = [one["advice"] or one["detail"] for one in quality["advice"]]
    return [", ".join(figure for figure in figures if figure), *(f"- {_plain(text)}" for text in advice)]


def _figure(name: str, value: float | None, form: str) -> str | None:
    return f"{name} {form.format(value)}" if value is not None else None


def _motion(quality: dict[str, Any]) -> str | None:
    length, direction = quality["motion_blur_px"], quality["motion_blur_direction_deg"]
    if length is None:
        return None
    return f"motion {length:.1f} px" + (f" at {direction:.0f} deg" if direction is not None else "")


def _plain(text: str) -> str:
    """Return a text in the letters that the pictures' font has."""
    for letter, spelt in (("°", " deg"), ("×", "x"), ("–", "-"), ("’", "'"), ("σ", "sigma")):
        text = text.replace(letter, spelt)
    return text.encode("ascii", "replace").decode()


def _write_quality(canvas: Any, quality: dict[str, Any], points: list[tuple[int, int]], radius: int) -> None:
    """Say how well the picture was taken, in the corner where the fewest points are."""
    import cv2

    size, weight, line_px, below = _lettering(radius)
    height, width = canvas.shape[:2]
    lines = _wrapped(quality_lines(quality), round(0.5 * width) - 2 * below, size, weight)
    broad = 2 * below + max(_width(line, size, weight) for line in lines)
    tall = below + line_px * len(lines)
    corners = [(0, 0), (width - broad, 0), (width - broad, height - tall)]  # in the fourth stands the legend

    def covered(corner: tuple[int, int]) -> int:
        left, top = corner
        return sum(left <= u < left + broad and top <= v < top + tall for u, v in points)

    left, top = min(corners, key=covered)
    left, top = max(0, left), max(0, top)
    box = canvas[top : top + tall, left : left + broad]
    box[:] = (0.2 * box + 0.8 * 255).astype(box.dtype)
    for k, line in enumerate(lines):
        at = (left + below, top + (k + 1) * line_px - below // 2)
        cv2.putText(canvas, line, at, cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), weight, cv2.LINE_AA)


def _write_legend(canvas: Any, radius: int) -> None:
    """Say in the lower left corner what the colours and lines are."""
    import cv2

    text = f"green: used   red: left out   lines: residuals x {RESIDUAL_SCALE:g}"
    size, weight, line_px, below = _lettering(radius)
    bottom = canvas.shape[0] - 1
    corner = (_width(text, size, weight) + 2 * below, bottom)
    cv2.rectangle(canvas, (0, bottom - line_px), corner, (255, 255, 255), cv2.FILLED)
    cv2.putText(
        canvas, text, (below, bottom - below), cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), weight, cv2.LINE_AA
    )


def _lettering(radius: int) -> tuple[float, int, int, int]:
    """Return the letters' size and weight, the height of a line, and that of a letter's tail."""
    import cv2

    size, weight = max(0.45, radius / 11), max(1, radius // 5)
    (_, height), below = cv2.getTextSize("Ag", cv2.FONT_HERSHEY_SIMPLEX, size, weight)
    return size, weight, height + 2 * below, below


def _width(text: str, size: float, weight: int) -> int:
    import cv2

    return int(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, weight)[0][0])


def _wrapped(lines: list[str], width: int, size: float, weight: int) -> list[str]:
    """Return lines that are at most so wide, in pixels; what is too long goes on in the next, indented."""
    wrapped: list[str] = []
    for line in lines:
        current = ""
        for word in line.split(" "):
            longer = f"{current} {word}" if current else word
            if current and _width(longer, size, weight) > width:
                wrapped.append(current)
                longer = f"  {word}"
            current = longer
        wrapped.append(current)
    return wrapped
