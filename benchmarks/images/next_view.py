"""Next views: how many images the suggested order needs for the uncertainty that a random order reaches.

Sessions are simulated as grid points with noise. Both orders begin with the same images; the suggested one goes on one
image at a time, from what is known so far, until it states what all images of the random order state.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from benchmarks.table import Row
from tests.support.sessions.planned_sessions import (
    DH,
    HAND_EYE,
    camera_images_needed,
    images_needed,
    least_mount_images,
)

LIMIT = 0.6
TRIALS = 8
"""Sessions of each seed: of 24 the mean is uncertain by about .01."""


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    trials = 1 if quick else TRIALS
    drawn = [1000 * seed + k for seed in seeds for k in range(trials)]
    yield _row("intrinsics", [camera_images_needed(seed) for seed in drawn], 4, 20)
    yield _row(
        "hand-eye", [images_needed(HAND_EYE, seed) for seed in drawn], HAND_EYE.begun, HAND_EYE.at_random
    )
    least = [least_mount_images(seed) for seed in drawn]
    yield Row.context(
        "next view, hand-eye: least images of any choice ÷ random order, mean",
        float(np.mean(least)),
        note=f"± {_standard_error(least):.3f}; A-optimal weights over the views that the random order's joints allow, "
        "the frames known beforehand",
    )
    yield _row("DH", [images_needed(DH, seed) for seed in drawn], DH.begun, DH.at_random)


def _row(what: str, shares: list[float], begun: int, at_random: int) -> Row:
    note = (
        f"± {_standard_error(shares):.3f}, {len(shares)} sessions that begin with {begun} images; {at_random} at "
        f"random; largest {max(shares):.2f}, {100.0 * np.mean(np.array(shares) <= LIMIT):.0f} % of the sessions at "
        f"most {LIMIT:g}"
    )
    return Row.at_most(
        f"next view, {what}: images ÷ random order, mean", float(np.mean(shares)), LIMIT, "", note
    )


def _standard_error(shares: list[float]) -> float:
    return float(np.std(shares, ddof=1)) / math.sqrt(len(shares))
