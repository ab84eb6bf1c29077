"""Images that try the detector, each made from its number alone: boards with rows shifted and squares missing, bent,
doubled and laid over one another; gratings, moiré and checks of a few pixels that fill the frame; noise and nothing."""

from __future__ import annotations

import cv2
import numpy as np

from core.targets import TargetSpec

Rng = np.random.Generator


def mutated_lattice(number: int) -> tuple[np.ndarray, TargetSpec]:
    """Return the image of this number, and the target to look for in it."""
    rng = np.random.default_rng([2, number])
    columns, rows = int(rng.integers(3, 13)), int(rng.integers(3, 10))
    if rng.random() < 0.02:
        width, height = (int(side) for side in rng.choice([1, 2, 7, 16, 33, 800], 2))
    else:
        width, height = int(rng.integers(120, 800)), int(rng.integers(90, 600))
    image = _background(width, height, rng)
    for _ in range(rng.choice([0, 1, 1, 1, 1, 2, 4])):
        image = _laid_over(image, _board(columns, rows, rng), rng)
    image = _exposed(_bent(image, rng) if rng.random() < 0.3 else image, rng)
    if rng.random() < 0.3:  # ask for a neighbour of what is shown
        columns, rows = max(3, columns + int(rng.integers(-1, 2))), max(3, rows + int(rng.integers(-1, 2)))
    if rng.random() < 0.2:
        columns, rows = rows, columns
    return image, TargetSpec("chessboard", columns, rows, pitch_mm=20.0)


def _background(width: int, height: int, rng: Rng) -> np.ndarray:
    """Return (h, w) light in 0..1."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    kind = rng.integers(9)
    if kind == 0:
        return np.full((height, width), rng.random(), np.float32)
    if kind == 1:
        return rng.random((height, width), np.float32)
    if kind == 2:  # clutter: rectangles
        image = np.full((height, width), 0.5, np.float32)
        for _ in range(rng.integers(1, 300)):
            corner, size = rng.integers(0, (width, height)), rng.integers(2, 60, 2)
            cv2.rectangle(image, corner.tolist(), (corner + size).tolist(), rng.random(), -1)
        return image
    pitch, turn = float(rng.uniform(2.0, 10.0)), float(rng.uniform(0, np.pi)) if rng.random() < 0.5 else 0.0
    cos, sin = float(np.cos(turn)), float(np.sin(turn))
    u, v = cos * x + sin * y, cos * y - sin * x
    if kind == 3:
        return 0.5 + 0.5 * np.sign(np.sin(np.pi * u / pitch))
    if kind == 4:  # checks with hard edges, as they alias
        return ((u // pitch + v // pitch) % 2 == 0).astype(np.float32)
    if kind == 5:  # the same, soft
        return 0.5 + 0.5 * np.sin(np.pi * u / pitch) * np.sin(np.pi * v / pitch)
    if kind == 6:  # moiré of two gratings
        other = pitch * float(rng.uniform(1.01, 1.2))
        return 0.5 + 0.25 * (np.sin(2 * np.pi * u / pitch) + np.sin(2 * np.pi * (u + 0.1 * v) / other))
    if kind == 7:  # checks that shrink: from far apart to finer than a pixel
        return 0.5 + 0.5 * np.sign(np.sin(x * x / (50 * pitch)) * np.sin(y * y / (50 * pitch)))
    return (x / width + y / height) / 2


def _board(columns: int, rows: int, rng: Rng) -> np.ndarray:
    """Return a board's texture in 0..1, its lattice mutated, with a white border."""
    squares = (np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2).astype(np.float64)
    for _ in range(rng.geometric(0.5) - 1):
        operation = rng.integers(6)
        row, column = rng.integers(squares.shape[0]), rng.integers(squares.shape[1])
        if operation == 0:
            squares[row, column] = rng.random()
        elif operation == 1:
            squares = np.delete(squares, row, axis=0) if len(squares) > 3 else squares
        elif operation == 2:
            squares = np.insert(squares, column, squares[:, column], axis=1)
        elif operation == 3:
            squares[row] = 1 - squares[row]
        elif operation == 4:
            squares = np.tile(squares, (1, 2))[:, : 2 * squares.shape[1] - int(rng.integers(2))]
        else:
            squares[row : row + int(rng.integers(1, 4)), column : column + int(rng.integers(1, 4))] = (
                rng.integers(2)
            )
    side = 16
    texture = np.kron(squares, np.ones((side, side))).astype(np.float32)
    if rng.random() < 0.3:  # part of the rows shifted, by less or more than a square
        row = rng.integers(len(texture))
        texture[row:] = np.roll(texture[row:], rng.integers(1, 2 * side), axis=1)
    for _ in range(rng.integers(0, 6) if rng.random() < 0.3 else 0):
        center = rng.integers(0, texture.shape[::-1])
        cv2.circle(texture, center.tolist(), int(rng.integers(2, side)), rng.random(), -1)
    return np.pad(texture, side, constant_values=1.0)


def _laid_over(image: np.ndarray, texture: np.ndarray, rng: Rng) -> np.ndarray:
    """Return the image with the board in it, under a random homography."""
    height, width = image.shape
    h, w = texture.shape
    scale = rng.uniform(0.15, 1.3) * min(width / w, height / h)
    turn = rng.uniform(-np.pi, np.pi) if rng.random() < 0.5 else rng.normal(0, 0.2)
    corners = np.array([[0, 0], [w, 0], [w, h], [0, h]], dtype=np.float64) - (w / 2, h / 2)
    turned = corners @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) * scale
    turned += rng.normal(0, rng.choice([0.0, 0.03, 0.12]) * scale * min(w, h), (4, 2))
    turned += (width / 2, height / 2) + rng.normal(0, 0.08, 2) * (width, height)
    H = cv2.getPerspectiveTransform(
        corners.astype(np.float32) + np.float32([w / 2, h / 2]), turned.astype(np.float32)
    )
    board = cv2.warpPerspective(texture, H, (width, height), flags=cv2.INTER_AREA)
    cover = cv2.warpPerspective(np.ones_like(texture), H, (width, height))
    if rng.random() < 0.15:
        cover *= float(rng.uniform(0.3, 1.0))  # shines through
    return board * cover + image * (1 - cover)


def _bent(image: np.ndarray, rng: Rng) -> np.ndarray:
    """Return the image through a strongly distorting lens, or with waves in it."""
    height, width = image.shape
    y, x = np.mgrid[:height, :width].astype(np.float32)
    u, v = (x - width / 2) / width, (y - height / 2) / width
    if rng.random() < 0.7:
        gain = 1 + float(rng.uniform(-1.2, 2.0)) * (u * u + v * v)
        return cv2.remap(image, u * gain * width + width / 2, v * gain * width + height / 2, cv2.INTER_LINEAR)
    size, length = float(rng.uniform(1, 12)), float(rng.uniform(10, 200))
    return cv2.remap(image, x + (size * np.sin(y / length)).astype(np.float32), y, cv2.INTER_LINEAR)


def _exposed(image: np.ndarray, rng: Rng) -> np.ndarray:
    """Return what a camera makes of light: blur, noise, gamma, too much or too little; 8 or 16 bit."""
    image = np.nan_to_num(image).clip(0, 1)
    if rng.random() < 0.7:
        image = cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.3, 3.0)))
    gain, stray_light = rng.choice([0.02, 0.3, 0.8, 0.8, 1.0, 3.0]), rng.choice([0, 0.1, 0.5])
    image = image ** float(rng.uniform(0.4, 2.5)) * float(gain) + float(stray_light)
    if rng.random() < 0.1:
        image = 1 - image
    most = 255 if rng.random() < 0.8 else 65_535
    noise = rng.standard_normal(image.shape, np.float32) * float(rng.choice([0, 1, 4, 20]) / 255)
    return np.round((image + noise) * most).clip(0, most).astype(np.uint8 if most == 255 else np.uint16)
