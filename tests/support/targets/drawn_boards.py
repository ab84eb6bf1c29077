"""Boards drawn upright, without a renderer."""

from __future__ import annotations

import cv2
import numpy as np

from core.targets import TargetSpec
from core.targets.lattice.lattice import Lattice

PITCH = 24
NINE_BY_SIX = TargetSpec("chessboard", 9, 6, 20.0)


def board(columns: int, rows: int, margin: int = 2, blur: float = 0.7) -> tuple[np.ndarray, np.ndarray]:
    """Return a drawn board (square (-1, -1) black) and its grid, upright."""
    squares = np.ones((rows + 1 + 2 * margin, columns + 1 + 2 * margin), np.float32)
    squares[margin:-margin, margin:-margin] = np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2
    image = np.kron(squares, np.ones((PITCH, PITCH), np.float32)) * 180.0 + 20.0
    y, x = np.mgrid[0:rows, 0:columns]
    grid = (np.stack([x, y], axis=2) + margin + 1.0) * PITCH - 0.5
    return np.rint(cv2.GaussianBlur(image, (0, 0), blur)).astype(np.uint8), grid


def lattice_of(grid: np.ndarray, *, origin_is_bright: bool) -> Lattice:
    shape = grid.shape[:2]
    return Lattice(grid, np.full(shape, 100.0), np.zeros(shape, dtype=bool), origin_is_bright)


def checks(square: int, shape: tuple[int, int]) -> np.ndarray:
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]]
    return ((v // square + u // square) % 2 * 200 + 20).astype(np.uint8)


def drawn_board(columns: int, rows: int, square: int = 12) -> np.ndarray:
    """A board upright in the middle of a bright image, with a margin of four squares."""
    image = np.full(((rows + 9) * square, (columns + 9) * square), 220, np.uint8)
    inner = slice(4 * square, -4 * square)
    image[inner, inner] = checks(square, ((rows + 1) * square, (columns + 1) * square))
    return image
