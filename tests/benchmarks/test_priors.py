"""The priors of single images are as wide as published calibrations have it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.images import priors
from benchmarks.table import Row


def published(
    rng: np.random.Generator, repositories: int, width: float, noise: float
) -> list[dict[str, str]]:
    """Return two calibrations each of as many cameras; p1 and p2 of each camera have this width, and noise."""
    found = []
    for k in range(repositories):
        truth = rng.normal(0.0, width, 2)
        for _ in range(2):
            p1, p2 = truth + rng.normal(0.0, noise, 2)
            values = {"width": 640, "height": 480, "fx": 500, "fy": 500, "cx": 319.5, "cy": 239.5, "k1": -0.3}
            row = {name: str(value) for name, value in values.items()}
            found.append(row | {"source_repo": f"r{k}", "p1": str(p1), "p2": str(p2)})
    return found


def test_the_noise_of_calibrations_is_not_taken_for_the_lens() -> None:
    rng = np.random.default_rng(3)
    products = priors._products(published(rng, 2000, 1e-3, 2e-3))["p1, p2"]
    assert len(products) == 2000
    # Over 8 seeds 0.946 ± 0.05 of it at half the number: the trimmed tails are not equal, which takes .06 away.
    assert priors._common(products, set(products)) == pytest.approx(1e-3, rel=0.12)


def test_a_calibration_stored_twice_is_one() -> None:
    (first, _) = published(np.random.default_rng(3), 1, 1e-3, 2e-3)
    assert priors._products([first, first])["p1, p2"] == {}


def test_priors_are_as_wide_as_what_calibrations_have_in_common(
    data_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GRIDPOSE_TEST_DATA", str(data_folder))
    rows: dict[str, Row] = {row.what: row for row in priors.rows([1], quick=True)}
    for name in ("principal point / longer side", "p1, p2"):
        low, high = map(float, rows[f"{name}: common to calibrations of the others"].measured.split(" to "))
        assert low <= priors.WIDTHS[name] <= high
