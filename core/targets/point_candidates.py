"""Candidates for grid points: what an image shows that looks like one, whether a target was found or not."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8

from core.targets.circles import find_dots
from core.targets.lattice import find_saddles, levels, link

MAX_CANDIDATES = 2_000
_MIN_LINKED = 3  # corners of a patch of lattice
_SAME_PX = 3.0


def candidate_points(image: UInt8[np.ndarray, "h w"], kind: str | None) -> Float[np.ndarray, "n 2"]:
    """Return the places (px) that look like grid points of a target of this kind; at most `MAX_CANDIDATES`.

    Corners of squares that are linked to neighbours, for boards of squares and where the kind is not known; centres of
    ellipses, for boards of dots. Each place is given once, whatever the number of pyramid levels that show it.
    """
    of_dots = kind in ("circles", "asymmetric_circles")
    found: list[Float[np.ndarray, "n 2"]] = []
    for level in levels(image):
        if of_dots:
            found += [level.to_full(dots.centres) for dots in find_dots(level)]
        else:
            saddles = find_saddles(level)
            patches = link(saddles)
            sizes = np.append(patches.sizes, 0)  # patch -1: none
            found.append(level.to_full(saddles.points[sizes[patches.patch] >= _MIN_LINKED]))
    places = np.concatenate([part.reshape(-1, 2) for part in reversed(found)] or [np.zeros((0, 2))])
    return _distinct(places)[:MAX_CANDIDATES]


def _distinct(places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 2"]:
    """Return the places without those that share a cell of a few pixels with an earlier one."""
    cells = np.floor(places / _SAME_PX).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return places[np.sort(first)]
