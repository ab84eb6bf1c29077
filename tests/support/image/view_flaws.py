"""What spoils mutated views (`mutated_views`): soiled sheets, things in front of them, light, blur and noise."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from core.targets.charuco.layout import charuco_layout
from core.targets.printed_pattern import DotPattern, RectilinearPattern
from core.targets.specification import TargetSpec
from tests.support.image import mutated_dots

SIZE_PX = (1000, 800)


def soiled(
    rng: np.random.Generator,
    sheet: RectilinearPattern | DotPattern,
    printed: TargetSpec,
    changes: list[str],
) -> RectilinearPattern | DotPattern:
    """Return the sheet with some of its cells in the other ink, or a piece of it pasted elsewhere; dots worn."""
    if isinstance(sheet, DotPattern):
        return mutated_dots.soiled_dots(rng, sheet, changes)
    white = sheet.white.copy()
    inner = white[2:-2, 2:-2]  # without what is around the sheet, and its margin
    if rng.random() < 0.4:
        wrong = rng.random(inner.shape) < 10.0 ** rng.uniform(-3.0, -1.0)
        inner[wrong] = 1.0 - inner[wrong]
        changes.append("flipped_cells")
    if printed.kind == "charuco" and rng.random() < 0.2:
        layout = charuco_layout(printed)
        parts = layout.marker_cells.shape[1] + 2
        for _ in range(int(rng.integers(1, 3))):
            (i, j), (m, n) = layout.marker_squares[rng.choice(len(layout.marker_squares), 2, replace=False)]
            inner[n * parts : (n + 1) * parts, m * parts : (m + 1) * parts] = inner[
                j * parts : (j + 1) * parts, i * parts : (i + 1) * parts
            ]
        changes.append("pasted_marker")
    return replace(sheet, white=white)


def mirrored(sheet: RectilinearPattern) -> RectilinearPattern:
    """Return the sheet mirrored about its middle column."""
    edges = sheet.x_edges[0] + sheet.x_edges[-1] - sheet.x_edges[::-1]
    return RectilinearPattern(
        np.ascontiguousarray(edges), sheet.y_edges, sheet.white[:, ::-1].copy(), sheet.sheet[:, ::-1].copy()
    )


def add_occluders(
    rng: np.random.Generator,
    levels: Float[np.ndarray, "h w"],
    points: Float[np.ndarray, "n 2"],
    changes: list[str],
) -> None:
    """Hold up to three things in front of the board."""
    size = float(np.max(np.ptp(points, axis=0)))
    for _ in range(int(rng.integers(0, 4))):
        kind = str(rng.choice(["hand", "cable", "paper"]))
        centre = points[rng.integers(len(points))] + rng.normal(0.0, 0.05 * size, 2)
        grey = float(rng.uniform(10.0, 235.0))
        if kind == "hand":
            angle = np.sort(rng.uniform(0.0, 2.0 * math.pi, 14))
            radius = rng.uniform(0.08, 0.3, 14) * size
            outline = centre + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            cv2.fillPoly(levels, [np.rint(outline).astype(np.int32)], grey)
        elif kind == "cable":
            steps = rng.normal(0.0, 0.06 * size, (30, 2)).cumsum(axis=0)
            path = np.rint(centre + steps - steps[15]).astype(np.int32)
            cv2.polylines(
                levels, [path], False, grey, max(2, int(rng.uniform(0.01, 0.06) * size)), cv2.LINE_AA
            )
        else:
            box = cv2.boxPoints(
                (tuple(centre), tuple(rng.uniform(0.1, 0.5, 2) * size), float(rng.uniform(0, 90)))
            )
            cv2.fillConvexPoly(levels, np.rint(box).astype(np.int32), grey, cv2.LINE_AA)
        changes.append(kind)


def taken(
    rng: np.random.Generator,
    levels: Float[np.ndarray, "h w"],
    points: Float[np.ndarray, "n 2"],
    changes: list[str],
) -> UInt8[np.ndarray, "h w"]:
    """Return the image as a camera takes it: light, blur, reflections, noise and compression."""
    width, height = SIZE_PX
    slope = rng.uniform(-0.3, 0.3, 2)
    light = (
        1.0 + slope[0] * np.linspace(-1.0, 1.0, width) + slope[1] * np.linspace(-1.0, 1.0, height)[:, None]
    )
    levels *= light.astype(np.float32)
    blur_px = 10.0 ** rng.uniform(-0.4, 0.3)
    levels = cv2.GaussianBlur(levels, (0, 0), blur_px)
    if rng.random() < 0.25:
        centre = points[rng.integers(len(points))]
        size = rng.uniform(0.05, 0.3, 2) * float(np.max(np.ptp(points, axis=0)))
        u = np.exp(-0.5 * ((np.arange(width) - centre[0]) / size[0]) ** 2)
        v = np.exp(-0.5 * ((np.arange(height) - centre[1]) / size[1]) ** 2)
        levels += (np.float32(rng.uniform(100.0, 600.0)) * np.outer(v, u)).astype(np.float32)
        changes.append("reflection")
    noise = rng.standard_normal((height, width), dtype=np.float32)
    levels = levels + np.float32(rng.choice([0.5, 2.0, 5.0, 12.0])) * noise
    image = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    if rng.random() < 0.3:
        quality = int(rng.integers(40, 95))
        image = cv2.imdecode(
            cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_GRAYSCALE
        )
        changes.append("jpeg")
    return np.asarray(image)


def trail(length_px: float, direction: float) -> Float[np.ndarray, "h w"]:
    """Return the kernel of a uniform motion about its middle."""
    size = 2 * math.ceil(length_px) + 1
    kernel = np.zeros((size, size), np.float32)
    for way in np.linspace(-0.5, 0.5, 801) * length_px:
        u, v = size // 2 + way * math.cos(direction), size // 2 + way * math.sin(direction)
        i, j = math.floor(u), math.floor(v)
        for du, dv in ((0, 0), (1, 0), (0, 1), (1, 1)):
            kernel[j + dv, i + du] += (1 - abs(u - i - du)) * (1 - abs(v - j - dv))
    return kernel / kernel.sum()
