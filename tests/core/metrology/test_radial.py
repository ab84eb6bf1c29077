"""The law of l̄ + 3 S_l: closed forms where they exist, and simulation where they do not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.metrology.rp_distribution import eigenvalues, long_run_rp, mean_length, rp_sampling_distribution


def test_eigenvalues_are_lapacks() -> None:
    rng = np.random.default_rng(1)
    roots = rng.normal(size=(500, 3, 3)) * rng.choice([1.0, 1e-2, 1e-4], size=(500, 1, 3))
    matrices = roots @ roots.transpose(0, 2, 1) - 0.3 * np.eye(3) * rng.random((500, 1, 1))
    expected = np.linalg.eigvalsh(matrices)[:, ::-1]
    scale = np.abs(expected).max(axis=1, keepdims=True)
    assert np.max(np.abs(eigenvalues(matrices) - expected) / scale) < 1e-7


@pytest.mark.parametrize("diagonal", [(0.0, 0.0, 0.0), (2.0, 2.0, 2.0), (3.0, 3.0, 1.0), (5.0, 0.0, 0.0)])
def test_eigenvalues_of_degenerate_matrices(diagonal: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(eigenvalues(np.diag(diagonal)), diagonal, atol=1e-7)


@pytest.mark.parametrize(
    ("spectrum", "length"),
    [
        ((1.0, 1.0, 1.0), 2.0 * math.sqrt(2.0 / math.pi)),  # Maxwell
        ((1.0, 1.0, 0.0), math.sqrt(math.pi / 2.0)),  # Rayleigh
        ((1.0, 0.0, 0.0), math.sqrt(2.0 / math.pi)),  # half-normal
    ],
)
def test_mean_length_is_that_of_the_chi_distributions(
    spectrum: tuple[float, float, float], length: float
) -> None:
    assert mean_length(np.array(spectrum)) == pytest.approx(length, rel=1e-12)


def test_mean_length_of_any_shape_is_the_simulated_one() -> None:
    rng = np.random.default_rng(2)
    z = rng.standard_normal((400_000, 3))
    for spectrum in ((1.0, 0.5, 0.2), (1.0, 0.1, 0.01), (4.0, 3.0, 0.5)):
        lengths = np.sqrt(z * z @ np.array(spectrum))
        error = 4.0 * lengths.std() / math.sqrt(len(z))
        assert mean_length(np.array(spectrum)) == pytest.approx(lengths.mean(), abs=error)


def test_long_run_reading_of_a_sphere_and_a_needle() -> None:
    # m + 3 √(tr - m²): 1.595769 + 3 √(3 - 2.546479), .797885 + 3 √(1 - .636620)
    assert long_run_rp(np.array([1.0, 1.0, 1.0])) == pytest.approx(3.616088, abs=1e-6)
    assert long_run_rp(np.array([1.0, 0.0, 0.0])) == pytest.approx(2.606315, abs=1e-6)


@pytest.mark.parametrize("cycles", [3.0, 5.0, 30.0, 1000.0])
def test_the_interval_holds_the_reading_and_narrows_with_cycles(cycles: float) -> None:
    shapes = np.array([[1.0, 1.0, 1.0], [1.0, 0.3, 0.1], [1.0, 0.0, 0.0]])
    low, high = rp_sampling_distribution(shapes, np.full(3, cycles)).interval(np.ones(3))
    assert np.all((low > 0.0) & (low < 1.0) & (high > 1.0))
    wider = rp_sampling_distribution(shapes, np.full(3, cycles + 1.0)).interval(np.ones(3))
    assert np.all(wider[1] - wider[0] < high - low)


def test_a_needle_is_less_certain_than_a_sphere() -> None:
    shapes = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    assert np.all(np.diff(rp_sampling_distribution(shapes, np.full(3, 30.0)).spread) > 0.0)


def test_no_scatter_has_an_interval_of_nothing() -> None:
    low, high = rp_sampling_distribution(np.zeros((1, 3)), np.array([30.0])).interval(np.zeros(1))
    assert (low[0], high[0]) == (0.0, 0.0)


def test_between_and_beyond_the_simulated_numbers_of_cycles() -> None:
    # The mean and the scatter of the logarithm of 4,000 readings at n = 17 and n = 400.
    rng = np.random.default_rng(3)
    for n, trials in ((17, 8000), (400, 4000)):
        for spectrum in ((1.0, 1.0, 1.0), (1.0, 0.3, 0.05)):
            z = rng.standard_normal((trials, n, 3)) * np.sqrt(spectrum)
            lengths = np.linalg.norm(z - z.mean(axis=1, keepdims=True), axis=2)
            reading = lengths.mean(axis=1) + 3.0 * lengths.std(axis=1, ddof=1)
            logs = np.log(reading / long_run_rp(np.array(spectrum)))
            law = rp_sampling_distribution(np.array([spectrum]), np.array([float(n)]))
            assert law.centre[0] == pytest.approx(logs.mean(), abs=5.0 * logs.std() / math.sqrt(trials))
            # 3 % for the spread is four standard errors of it, and the shapes between nodes.
            assert law.spread[0] == pytest.approx(logs.std(), rel=0.04)


def test_scatter_next_to_nothing_has_a_length_next_to_nothing() -> None:
    spectra = np.array([[1e-300, 1e-300, 1e-301], [0.0, 0.0, 0.0], [1e-30, 0.0, 0.0], [4.0, 4.0, 4.0]])
    found = mean_length(spectra)
    assert np.all(np.isfinite(found))
    np.testing.assert_allclose(
        found, [0.0, 0.0, 1e-15 * np.sqrt(2.0 / np.pi), 4.0 * np.sqrt(2.0 / np.pi)], atol=1e-150
    )
