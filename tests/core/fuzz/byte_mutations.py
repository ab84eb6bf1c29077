"""Bytes of any file changed, cut and repeated, and odd values to put into one."""

from __future__ import annotations

import numpy as np

Rng = np.random.Generator


def bytes_changed(data: bytes, rng: Rng) -> bytes:
    changed = bytearray(data)
    begin = min(64, len(data)) if rng.random() < 0.5 else len(data)  # the beginning decides most
    for _ in range(rng.integers(1, 9)):
        place = rng.integers(begin)
        changed[place] = odd_byte(rng) if rng.random() < 0.5 else changed[place] ^ (1 << rng.integers(8))
    return bytes(changed)


def cut_short(data: bytes, rng: Rng) -> bytes:
    return data[: rng.integers(1, len(data) + 1)]


def part_removed(data: bytes, rng: Rng) -> bytes:
    begin, end = np.sort(rng.integers(0, len(data) + 1, 2))
    return data[:begin] + data[min(end, begin + 40) :] or b"\0"


def part_repeated(data: bytes, rng: Rng) -> bytes:
    begin, end = np.sort(rng.integers(0, len(data) + 1, 2))
    return data[:end] + data[begin:end][:4000] * rng.integers(1, 4) + data[end:]


def part_overwritten(data: bytes, rng: Rng) -> bytes:
    begin = rng.integers(len(data))
    size = min(len(data) - begin, rng.integers(1, 30))
    return data[:begin] + bytes([odd_byte(rng)]) * size + data[begin + size :]


def odd_byte(rng: Rng) -> int:
    return int(rng.choice([0, 1, 2, 3, 4, 5, 8, 16, 127, 128, 254, 255, rng.integers(256)]))


def odd_number(rng: Rng, bits: int) -> int:
    near = int(rng.choice([0, 1, 2, 3, 7, 8, 100, 1000, 5000, 65_535, 2**31 - 1, 2**31, 2**32 - 1, 2**63]))
    return (near + int(rng.integers(-2, 3))) % 2**bits
