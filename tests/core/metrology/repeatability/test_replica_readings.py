"""The kernel of bias correction against its twin: closed-form eigenvalues, and Carlson's R_G of scipy."""

from __future__ import annotations

import numpy as np
import pytest

from core.metrology.repeatability.replica_readings import replica_readings
from core.metrology.rp_distribution import eigenvalues, long_run_rp


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize(
    "spectrum", [(1.0, 1.0, 1.0), (1.0, 0.5, 0.2), (1.0, 1.0, 0.0), (1.0, 1e-8, 1e-12), (1.0, 0.0, 0.0)]
)
def test_readings_are_those_of_the_twin(spectrum: tuple[float, float, float], noise: float) -> None:
    rng = np.random.default_rng(1)
    turns = np.linalg.qr(rng.normal(size=(20, 3, 3)))[0]
    roots = np.ascontiguousarray(1e-2 * turns * np.sqrt(spectrum))
    factors = np.tril(rng.normal(size=(30, 3, 3)))
    of_noise = 1e-4 * noise * np.tile(np.diag([1.0, 0.6, 0.2]), (20, 1, 1))
    B = roots[:, None] @ factors
    expected = long_run_rp(eigenvalues(B @ B.swapaxes(2, 3) - of_noise[:, None]))
    # Closed-form eigenvalues are exact to 1e-8 of the largest, and two orders of their sums may differ by a few of
    # those.
    assert replica_readings(roots, factors, of_noise) == pytest.approx(expected, rel=1e-7, abs=1e-10)


def test_no_scatter_reads_nothing() -> None:
    none = np.zeros((1, 3, 3))
    assert replica_readings(none, np.eye(3)[None], none).tolist() == [[0.0]]
