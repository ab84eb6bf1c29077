"""Slopes of the light: noise alone makes none of them uncertain, a small reflection does."""

from __future__ import annotations

import numpy as np
import pytest

from core.targets.subpixel.light_slopes import grid_slopes
from core.targets.subpixel.smooth_map import grid_basis


@pytest.mark.parametrize("size", [(9, 6), (14, 10), (25, 18)])
def test_noise_makes_no_slope_uncertain(size: tuple[int, int]) -> None:
    """Or the corner would weigh less in that image alone, and its pose be moved by what is systematic in it."""
    rng = np.random.default_rng(1)
    column, row = (place.ravel() for place in np.meshgrid(np.arange(size[0]), np.arange(size[1])))
    ideal = np.stack([column, row], axis=1).astype(np.float64)
    basis = grid_basis(ideal, 30.0 * ideal + 100.0, np.ones(len(ideal)))
    known = np.ones(len(ideal), dtype=np.bool_)
    uncertain = 0
    for _ in range(200):
        values = 100.0 + rng.standard_normal((len(ideal), 2))
        _, sigmas = grid_slopes(basis, ideal, column, row, values, known)
        uncertain += bool(sigmas[:, 0].any())
    assert uncertain <= 2  # of 200 images: chance correlates neighbours in one of 700
    values[len(values) // 2 + 1, 0] += 20.0
    _, sigmas = grid_slopes(basis, ideal, column, row, values, known)
    assert sigmas[len(values) // 2 + 1, 0].min() > 2.0
