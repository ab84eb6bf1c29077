"""The markers of a dictionary as numbers, and the lookup of words read in an image.

A marker's bits, row by row, are the digits of a 64-bit number, the first one the highest; white is 1. What was read is
the marker nearest in Hamming's distance, if no more bits differ than the dictionary puts right without taking one
marker for another (OpenCV's share of them).

Reference: Garrido-Jurado et al. 2014 as in `core.targets.charuco.layout`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Int64, UInt64

from core.jit import jit

_PUT_RIGHT = 0.6  # of the bits that the dictionary's least distance allows, OpenCV's errorCorrectionRate
_CHANCE = 1e-6  # of a dictionary's markers being read, at consistent places, in an image without any
_TRIES = 100  # places that are read in an image


@dataclass(frozen=True, slots=True)
class MarkerDictionary:
    """A dictionary's codes: `codes[r, k]` of marker k turned by r quarter turns as `numpy.rot90` turns it.

    `side` is the number of bits along a side, the border not counted; `max_hamming` how many may be wrong.
    """

    side: int
    codes: UInt64[np.ndarray, "4 n"]
    max_hamming: int

    @property
    def least_agreeing(self) -> int:
        """How many markers must agree on where the board is, for chance not to have made them: two, of poor codes more.

        In N places with random bits m read by chance as one of n markers in four turns, and as those that belong next
        to it, with C(N, m) · 4 n V / 2^b · (V / 2^b)^(m - 1), V the number of words within the allowed distance.
        """
        bits = self.side**2
        words = sum(math.comb(bits, wrong) for wrong in range(self.max_hamming + 1)) / 2.0**bits
        agreeing = 2
        while math.comb(_TRIES, agreeing) * 4 * self.codes.shape[1] * words**agreeing > _CHANCE:
            agreeing += 1
        return agreeing


@lru_cache(maxsize=8)
def marker_codes(dictionary: str) -> MarkerDictionary:
    """Return the codes of one of OpenCV's dictionaries, by its name there, DICT_..."""
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    side = int(known.markerSize)
    bits = marker_bits(dictionary)
    turned = [code_of(np.rot90(bits, turn, axes=(1, 2))) for turn in range(4)]
    return MarkerDictionary(side, np.array(turned), int(known.maxCorrectionBits * _PUT_RIGHT))


@lru_cache(maxsize=8)
def marker_bits(dictionary: str) -> Bool[np.ndarray, "n side side"]:
    """Return the bits of one of OpenCV's dictionaries, white True; the array is shared, and may not be written to."""
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    side, count = int(known.markerSize), len(known.bytesList)
    rows = (known.bytesList[k : k + 1] for k in range(count))
    bits = np.array([cv2.aruco.Dictionary.getBitsFromByteList(row, side) for row in rows], dtype=np.bool_)
    bits.flags.writeable = False
    return bits


def code_of(bits: Bool[np.ndarray, "n side side"]) -> UInt64[np.ndarray, " n"]:
    """Return the numbers whose digits are these bits."""
    digits = bits.reshape(len(bits), bits.shape[1] * bits.shape[2])
    worth = np.left_shift(np.uint64(1), np.arange(digits.shape[1] - 1, -1, -1, dtype=np.uint64))
    return np.asarray(np.where(digits, worth, np.uint64(0)).sum(axis=1, dtype=np.uint64))


@jit("u8[::1], u8[:, ::1], i8")
def nearest_markers(
    read: UInt64[np.ndarray, " n"], codes: UInt64[np.ndarray, "4 k"], max_hamming: int
) -> Int64[np.ndarray, "n 3"]:
    """Return marker, turn and distance (bits) of the nearest code to each number read; marker -1 where none is near."""
    found = np.empty((len(read), 3), dtype=np.int64)
    one = np.uint64(1)
    for n in range(len(read)):
        found[n, 0], found[n, 1], found[n, 2] = -1, 0, max_hamming + 1
        for turn in range(codes.shape[0]):
            for k in range(codes.shape[1]):
                different = read[n] ^ codes[turn, k]
                distance = 0
                while different != np.uint64(0) and distance < found[n, 2]:
                    different &= different - one
                    distance += 1
                if distance < found[n, 2]:
                    found[n, 0], found[n, 1], found[n, 2] = k, turn, distance
    return found
