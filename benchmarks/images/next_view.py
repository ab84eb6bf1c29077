"""Next views: how many images the suggested order needs for the uncertainty that a random order reaches.

Sessions are simulated as grid points with noise. Both orders begin with the same images; the suggested one goes on one
image at a time, from what is known so far, until it states what all images of the random order state.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from benchmarks.table import Row
from tests.support.sessions.planned_sessions import DH, HAND_EYE, camera_images_needed, images_needed

LIMIT = 0.6


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    trials = 1 if quick else 3
    drawn = [1000 * seed + k for seed in seeds for k in range(trials)]
    yield _row("intrinsics", [camera_images_needed(seed) for seed in drawn], 4, 20)
    for name, plan in (("hand-eye", HAND_EYE), ("DH", DH)):
        yield _row(name, [images_needed(plan, seed) for seed in drawn], plan.begun, plan.at_random)


def _row(what: str, shares: list[float], begun: int, at_random: int) -> Row:
    note = (
        f"{len(shares)} sessions that begin with {begun} images; {at_random} at random; largest "
        f"{max(shares):.2f}, {100.0 * np.mean(np.array(shares) <= LIMIT):.0f} % of the sessions at most {LIMIT:g}"
    )
    return Row.at_most(
        f"next view, {what}: images ÷ random order, mean", float(np.mean(shares)), LIMIT, "", note
    )
