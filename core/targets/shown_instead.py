"""What a picture shows in place of the target that was looked for: a board of squares of another kind.

A chessboard and a ChArUco board are the same lattice of squares; what tells them apart is whether most of the bright
squares have a marker in them. Both are found here by that lattice, whatever its size. Said of pictures in which the
target itself was not found, it spares the search for poor light or a wrong size where the wrong board was clamped.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from core.errors import TargetMismatch, TargetNotFound
from core.targets.charuco_lattice import lattices_of
from core.targets.charuco_layout import charuco_layout
from core.targets.chessboard import boards_in_view
from core.targets.detect import detect
from core.targets.lattice import Lattice
from core.targets.pyramid import levels
from core.targets.specification import GridPoints, TargetSpec

_ASKED = {
    "chessboard": "a chessboard, whose squares are plain,",
    "charuco": "a ChArUco board",
    "circles": "a board of dots",
    "asymmetric_circles": "a board of staggered dots",
    "aprilgrid": "an AprilGrid",
}
_ACROSS = np.linspace(
    0.2, 0.8, 9
)  # of a square: clear of its edges, over markers of half the square and more
_PRINTED = (
    0.2  # share of a bright square that is dark: with a marker of half its side, whose border alone is, .24
)
_MOST = 0.7  # of the bright squares
_LEAST_SQUARES, _LEAST_CORNERS = 4, 12
_LEAST_OF_PLAIN = 20  # corners: within a marker or between two a few may look like a board's
_USUAL = TargetSpec("charuco", 3, 3, 4.0, 3.0, "DICT_4X4_50")
"""For the margin between squares and markers, by which corners are linked: other markers may be larger or smaller."""


def look_for(image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], target: TargetSpec) -> GridPoints:
    """Find the one target that a picture should show; as `core.targets.detect.detect`.

    Where it is not found, but a board of another kind is wholly in view, TargetMismatch says so in place of
    TargetNotFound.
    """
    try:
        return detect(image, target)
    except TargetNotFound as failure:
        instead = _shown_instead(image, target)
        if instead is None:
            raise
        raise instead from failure


def _shown_instead(image: np.ndarray, target: TargetSpec) -> TargetMismatch | None:
    """Return what to say of the largest board of squares of another kind; None where there is none."""
    seen: list[tuple[int, str]] = []
    for level in levels(image):
        for lattice in lattices_of(image, level, charuco_layout(_USUAL)):
            count = int(lattice.known.sum())
            if count >= _LEAST_CORNERS and _has_markers(image, lattice):
                seen.append((count, f"A ChArUco board of at least {_size(lattice)} inner corners"))
    if target.kind == "charuco" and seen:  # what is wrong with it, its markers tell
        return None
    if target.kind != "chessboard":
        for board in boards_in_view(image):
            count = int(board.lattice.known.sum())
            is_plain = count >= _LEAST_OF_PLAIN and not _has_markers(image, board.lattice)
            if is_plain and board.is_whole and board.is_resolved:
                seen.append((count, f"A chessboard of {_size(board.lattice)} inner corners"))
    if not seen:
        return None
    _, named = max(seen)
    return TargetMismatch(
        f"{named} is in view; {_ASKED[target.kind]} of {target.columns} x {target.rows} was asked for.",
        "Show the target that the image was sent for, or send it for the one that it shows.",
    )


def _size(lattice: Lattice) -> str:
    long, short = sorted(lattice.gap.shape, reverse=True)
    return f"{long} x {short}"


def _has_markers(image: np.ndarray, lattice: Lattice) -> bool:
    """Tell whether most of the bright squares have something dark printed in them."""
    rows, columns = lattice.gap.shape
    bright: list[Float[np.ndarray, " n"]] = []
    dark: list[Float[np.ndarray, " n"]] = []
    for j in range(rows - 1):
        for i in range(columns - 1):
            corners = lattice.grid[j : j + 2, i : i + 2]
            if np.isfinite(corners).all():
                is_bright = ((i + j) % 2 == 0) == lattice.origin_is_bright
                (bright if is_bright else dark).append(_greys(image, corners))
    if len(bright) < _LEAST_SQUARES or not dark:
        return False
    black = float(np.median(dark))
    white = np.quantile(bright, 0.9, axis=1)
    share = np.mean(np.array(bright) < 0.5 * (black + white)[:, None], axis=1)
    return bool(np.mean(share > _PRINTED) > _MOST)


def _greys(image: np.ndarray, corners: Float[np.ndarray, "2 2 2"]) -> Float[np.ndarray, " n"]:
    """Return the picture's levels at places spread over the middle of a square."""
    y, x = (a.ravel()[:, None] for a in np.meshgrid(_ACROSS, _ACROSS, indexing="ij"))
    upper = (1.0 - x) * corners[0, 0] + x * corners[0, 1]
    lower = (1.0 - x) * corners[1, 0] + x * corners[1, 1]
    u, v = np.rint((1.0 - y) * upper + y * lower).astype(np.intp).T
    height, width = image.shape
    return image[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)].astype(np.float64)
