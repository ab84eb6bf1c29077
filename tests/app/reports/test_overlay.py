"""The drawing of an overlay: every mark in its place, and sizes by the width asked for alone."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from app.reports.overlay import (
    Axis,
    OverlayContent,
    Points,
    Statement,
    draw_overlay,
    draw_thumbnail,
    encode_drawing,
)
from app.reports.overlay.lettering import Type, text_width, wrapped
from app.reports.overlay.marks import residual_scale

WIDTHS = (320, 800, 1600)


def content(size: tuple[int, int] = (640, 480), **changes: Any) -> OverlayContent:
    """Return a grey image with three grid points: used, rejected, and not judged."""
    width, height = size
    values: dict[str, Any] = {
        "grey": np.full((height, width), 128, np.uint8),
        "image_width_px": width,
        "image_height_px": height,
        "statement": Statement(
            "refused", "Not calibrated (code): pose P1", ("A reason.", "Advice: another.")
        ),
        "points": Points(
            np.array([[0.25, 0.25], [0.5, 0.5], [0.75, 0.25]]) * size,
            np.array([[0.1, 0.0], [0.0, 3.0], [np.nan, np.nan]]),
            np.array([True, False, False]),
            np.array([True, True, False]),
        ),
    }
    return OverlayContent(**{**values, **changes})


def is_coloured(part: np.ndarray) -> bool:
    """Return whether anything is drawn on the grey."""
    return bool((part.max(axis=2).astype(int) - part.min(axis=2)).max() > 60)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("size", [(64, 48), (640, 480), (2560, 1920)])
def test_marks_are_where_the_points_are_whatever_the_sizes(width: int, size: tuple[int, int]) -> None:
    drawn = draw_overlay(content(size), width)
    assert drawn.shape[1] == width
    height = round(0.75 * width)
    assert drawn.shape[0] > height + 40
    for u, v in ((0.25, 0.25), (0.5, 0.5), (0.75, 0.25)):
        column, row, reach = round(u * width), round(v * height), max(6, width // 80)
        assert is_coloured(drawn[row - reach : row + reach, column - reach : column + reach])
    corner = drawn[: height // 8, : width // 8]
    assert corner.min() == corner.max() == 128


@pytest.mark.parametrize("width", WIDTHS)
def test_the_drawing_does_not_depend_on_how_the_image_was_reduced(width: int) -> None:
    whole = content((2560, 1920))
    reduced = content((2560, 1920), grey=np.full((480, 640), 128, np.uint8))
    np.testing.assert_array_equal(draw_overlay(whole, width), draw_overlay(reduced, width))


@pytest.mark.parametrize("size", [(4000, 5), (30, 4000), (1, 1)])
def test_a_very_long_image_stays_within_bounds(size: tuple[int, int]) -> None:
    drawn = draw_overlay(content(size, points=None), 320)
    assert drawn.shape[1] == 320
    assert drawn.shape[0] < 1.5 * 320 + 300


def test_axes_are_red_green_and_blue() -> None:
    axes = (
        Axis("x", (100.0, 100.0), (300.0, 100.0)),
        Axis("y", (100.0, 100.0), (100.0, 300.0)),
        Axis("z", (100.0, 100.0), (250.0, 250.0)),
    )
    drawn = draw_overlay(content(axes=axes, points=None), 640).astype(int)
    for (u, v), channel in (((200, 100), 2), ((100, 200), 1), ((200, 200), 0)):
        colour = drawn[v, u]
        assert colour[channel] > 1.5 * np.delete(colour, channel).max()


def test_candidates_are_drawn_where_no_point_was_found() -> None:
    candidates = np.array([[320.0, 240.0]])
    with_marks = draw_overlay(content(points=None, candidates_px=candidates), 640)
    assert is_coloured(with_marks[232:249, 312:329])
    assert not is_coloured(draw_overlay(content(points=None), 640)[:480])


def test_the_median_residual_is_visible_at_every_width() -> None:
    residuals = np.array([[0.01, 0.0], [0.0, 0.02], [0.03, 0.0]])
    for width in WIDTHS:
        scale = residual_scale(residuals, width, width / 2448)
        assert scale is not None
        length = 0.02 * scale * width / 2448
        assert 0.4 / 32 <= length / width <= 1.001 / 32
        assert float(f"{scale:.0e}") == scale
        assert str(f"{scale:.0e}")[0] in "125"
    assert residual_scale(np.zeros((3, 2)), 800, 1.0) is None
    assert residual_scale(np.full((3, 2), np.nan), 800, 1.0) is None


def test_lines_fit_their_width_and_nothing_is_lost() -> None:
    kind = Type.of(12)
    text = "The focal length is uncertain by 14.6 % (σ), tilt the target by 15° – " + "x" * 200
    lines = wrapped([text], 240, kind)
    assert all(text_width(line, kind) <= 240 for line in lines)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
    assert wrapped(["", "  "], 240, kind) == []


def test_text_is_written_at_the_same_share_of_every_width() -> None:
    panels = [draw_overlay(content(points=None), width)[round(0.75 * width) :] for width in WIDTHS]
    heights = [len(panel) / width for panel, width in zip(panels, WIDTHS, strict=True)]
    assert all((panel < 100).any() for panel in panels)
    assert max(heights) < 3.0 * min(heights)  # small drawings have relatively larger letters


@pytest.mark.parametrize(("size", "expected"), [((2560, 1920), (240, 320)), ((64, 48), (48, 64))])
def test_thumbnails_are_small(size: tuple[int, int], expected: tuple[int, int]) -> None:
    data = draw_thumbnail(np.full(size[::-1], 77, np.uint8))
    assert data[8:12] == b"WEBP"
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert decoded.shape == expected
    assert abs(int(decoded.mean()) - 77) <= 2


def test_drawings_are_encoded_as_asked_for() -> None:
    drawn = draw_overlay(content(), 320)
    png = encode_drawing(drawn, "image/png")
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR), drawn)
    assert encode_drawing(drawn, "image/webp")[8:12] == b"WEBP"
