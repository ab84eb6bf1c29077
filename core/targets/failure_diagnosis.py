"""Identify the board of squares that an image shows in place of the requested target.

A chessboard and a ChArUco board are the same lattice of squares; they are distinguished by whether most of the
bright squares have a marker in them. Both are found here by that lattice, whatever its size. The error for an image
without the target then names the board that was mounted instead, and nobody needs to search for poor light or a
wrong size.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8, UInt16

from core.errors import DetectionError, OriginUnknown, TargetMirrored, TargetMismatch, TargetNotFound
from core.targets.charuco import charuco_layout, lattices_of
from core.targets.chessboard import boards_in_view
from core.targets.detection import detect
from core.targets.lattice import Lattice, find_saddles, levels
from core.targets.markers import places_in_squares
from core.targets.specification import GridPoints, TargetSpec

_ASKED = {
    "chessboard": "a chessboard, whose squares are plain,",
    "charuco": "a ChArUco board",
    "circles": "a board of dots",
    "asymmetric_circles": "a board of staggered dots",
    "aprilgrid": "an AprilGrid",
}
_ACROSS = np.linspace(0.2, 0.8, 9)
"""Of a square: clear of its edges, over markers of half the square and more."""
_AROUND = 0.1
"""Of a square: a cell of a marker is about as wide."""
_PRINTED = 0.2
"""Share of a bright square that is dark. With a marker of half its side the marker's border alone makes .24."""
_ENDS = np.array([0, 1, -2, -1])  # of `_ACROSS`: taken both ways, what is near a square's corners
_SPOT = 0.2
"""Of the contrast, by which a bright square's middle is darker than its corners where its marker is out of focus: a
marker of half its side by .3 and more. Of a plain square that is blurred the corners are darker."""
_MAJORITY = 0.7  # of the bright squares
_MIN_SQUARES, _MIN_CORNERS = 4, 12
_MIN_OF_PLAIN = 20  # corners: within a marker or between two a few may look like a board's
_MAX_SIDE_PX = 1400
"""Of the image that is searched: a board a tenth as wide still has 17 squares of 8 px."""
_MAX_SADDLES = 10_000  # a board of 50 x 50 corners with markers in it has as many
_MAX_SQUARES = 400  # looked at for markers
_INVERTED_ADVICE = (
    "Print the board black on white; if it is, its grey values were inverted on the way: undo that."
)
_OTHER_ADVICE = "Show the target that the image was sent for, or send it for the one that it shows."
_FOCUS_ADVICE = (
    "If this is that board, its markers are too blurred to be seen: focus, or move the camera nearer. If not, show it, "
    "or send the image for the target that it shows."
)
_USUAL = TargetSpec("charuco", 3, 3, 4.0, 3.0, "DICT_4X4_50")
"""For the margin between squares and markers, by which corners are linked: other markers may be larger or smaller."""


def look_for(image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], target: TargetSpec) -> GridPoints:
    """Find the one target that an image should show; as `core.targets.detection.detect`.

    Where it is not found, but a board of another kind is wholly in view, TargetMismatch says so in place of
    TargetNotFound or OriginUnknown.
    """
    try:
        return detect(image, target)
    except (TargetNotFound, OriginUnknown) as failure:
        instead = _shown_instead(image, target)
        if instead is None:
            raise
        raise instead from failure


def _shown_instead(image: np.ndarray, target: TargetSpec) -> TargetMismatch | None:
    """Return the error that names the largest board of squares of another kind; None without such a board."""
    image = _searched(image)
    if target.kind == "aprilgrid" and _shows_inverted(image, target):
        return TargetMismatch("An AprilGrid is in view, white on black.", _INVERTED_ADVICE)
    seen: list[tuple[int, str, str]] = []  # corners, name, advice
    for level in levels(image):
        for lattice in lattices_of(image, level, charuco_layout(_USUAL)):
            count = int(lattice.known.sum())
            if count < _MIN_CORNERS:
                continue
            named = f"A ChArUco board of at least {_size(lattice)} inner corners"
            if _has_markers(image, lattice):
                seen.append((count, named, _OTHER_ADVICE))
            elif _has_markers(image, lattice, inverted=True):
                seen.append((count, f"{named}, white on black,", _INVERTED_ADVICE))
    if target.kind == "charuco" and any(advice == _OTHER_ADVICE for *_, advice in seen):
        return None  # its markers explain the failure
    if target.kind != "chessboard":
        for board in boards_in_view(image):
            count = int(board.lattice.known.sum())
            is_plain = count >= _MIN_OF_PLAIN and not any(
                _has_markers(image, board.lattice, inverted=inverted) for inverted in (False, True)
            )
            if is_plain and board.is_whole and board.is_resolved:
                size = _size(board.lattice)
                is_same_size = target.kind == "charuco" and size == _size_of(target.columns, target.rows)
                advice = _FOCUS_ADVICE if is_same_size else _OTHER_ADVICE
                seen.append((count, f"A chessboard of {size} inner corners", advice))
    if not seen:
        return None
    _, shown, advice = max(seen)
    return TargetMismatch(
        f"{shown} is in view; {_ASKED[target.kind]} of {target.columns} x {target.rows} was asked for.",
        advice,
    )


def _shows_inverted(image: np.ndarray, target: TargetSpec) -> bool:
    """Return whether an image shows tags of an AprilGrid once its grey values are inverted."""
    try:
        detect(np.iinfo(image.dtype).max - image, target)
    except (TargetMismatch, TargetMirrored):
        return True
    except DetectionError:
        return False
    return True


def _searched(image: np.ndarray) -> np.ndarray:
    """Return the image so far reduced that it has at most `_MAX_SIDE_PX`, and `_MAX_SADDLES` places like corners.

    The search serves a sentence: it must not take longer than that for the target. Fine texture makes more lattices
    and larger ones than any board.
    """
    chosen: np.ndarray | None = None
    for level in levels(image):
        is_small = max(level.image.shape) <= _MAX_SIDE_PX and len(find_saddles(level)) <= _MAX_SADDLES
        if chosen is not None and not is_small:
            break
        chosen = level.image
    return image if chosen is None else np.ascontiguousarray(chosen)


def _size(lattice: Lattice) -> str:
    return _size_of(*lattice.gap.shape)


def _size_of(columns: int, rows: int) -> str:
    """Return a board's size as it is seen, whichever way up."""
    return f"{max(columns, rows)} x {min(columns, rows)}"


def _has_markers(image: np.ndarray, lattice: Lattice, *, inverted: bool = False) -> bool:
    """Return whether most of the bright squares have something dark printed in them; `inverted`, of the dark ones
    something bright.

    Its size and its bits are not known, so that `decode_markers` cannot look for a frame.
    """
    known = lattice.known
    row, column = np.nonzero(known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:])
    if len(row) > _MAX_SQUARES:
        chosen = np.random.default_rng(0).choice(len(row), _MAX_SQUARES, replace=False)
        row, column = row[chosen], column[chosen]
    is_bright = ((row + column) % 2 == 0) == lattice.origin_is_bright
    middle = np.stack(np.meshgrid(_ACROSS, _ACROSS), axis=2).reshape(-1, 2)
    corners_px = np.pad(lattice.grid, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    places = places_in_squares(corners_px, np.stack([column, row], axis=1), middle)
    is_convex = np.isfinite(places).all(axis=(1, 2))
    # Of each place its surroundings: the dots of a dithered image are no print.
    square_px = min(
        float(np.nanmedian(np.linalg.norm(np.diff(lattice.grid, axis=k), axis=2))) for k in (0, 1)
    )
    width = 2 * round(0.5 * _AROUND * square_px) + 1
    image = cv2.blur(image, (width, width), borderType=cv2.BORDER_REPLICATE)
    u, v = np.moveaxis(np.rint(np.where(np.isfinite(places), places, 0.0)).astype(np.intp), 2, 0)
    greys = image[np.clip(v, 0, image.shape[0] - 1), np.clip(u, 0, image.shape[1] - 1)].astype(np.float64)
    if inverted:
        is_bright, greys = ~is_bright, -greys
    bright, dark = greys[is_bright & is_convex], greys[~is_bright & is_convex]
    if len(bright) < _MIN_SQUARES or len(dark) == 0:
        return False
    white, black = np.quantile(bright, 0.9, axis=1), np.median(dark)
    share = np.mean(bright < 0.5 * (black + white)[:, None], axis=1)
    squares = bright.reshape(-1, len(_ACROSS), len(_ACROSS))
    corners, middles = squares[:, _ENDS][:, :, _ENDS], squares[:, 2:-2, 2:-2]
    spot = corners.mean(axis=(1, 2)) - middles.mean(axis=(1, 2))
    return bool(np.mean((share > _PRINTED) | (spot > _SPOT * (white - black))) > _MAJORITY)
