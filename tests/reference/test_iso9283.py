"""Published figures and other people's measurements through the ISO 9283 engine."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from core.metrology import PoseCycles, Verdict, assess_repeatability
from core.metrology.iso9283 import position_repeatability, three_sigma
from core.metrology.rp_distribution import long_run_rp

# A. A. Michelson's hundred determinations of the speed of light (1879), km/s over 299,000, as NIST's statistical
# reference dataset "Michelso" has them: certified mean 299.852400000000 and standard deviation 0.0790105478190518
# (in thousands of km/s), computed there with 500 digits.
MICHELSON = """
850 740 900 1070 930 850 950 980 980 880 1000 980 930 650 760 810 1000 1000 960 960
960 940 960 940 880 800 850 880 900 840 830 790 810 880 880 830 800 790 760 800
880 880 880 860 720 720 620 860 970 950 880 910 850 870 840 840 850 840 840 840
890 810 810 820 800 770 760 740 750 760 910 920 890 860 880 720 840 850 850 780
890 840 780 810 760 810 790 810 820 850 870 870 810 740 810 940 950 800 810 870
"""


def test_three_sigma_is_the_certified_one() -> None:
    values = 299.0 + np.array(MICHELSON.split(), float)[:, None] / 1000.0
    assert three_sigma(values)[0] == pytest.approx(3.0 * 0.0790105478190518, rel=1e-13)
    cycles = PoseCycles(np.hstack([values, np.zeros((100, 2))]))
    result = assess_repeatability([cycles])[0]
    assert result.mean_position_mm[0] == pytest.approx(299.8524, rel=1e-14)
    assert result.repeatability.x_mm == pytest.approx(3.0 * 0.0790105478190518, rel=1e-13)


@pytest.mark.parametrize("offset", [1.0e6, 1.0e7])
def test_three_sigma_far_from_the_origin(offset: float) -> None:
    # NIST's "NumAcc3" and "NumAcc4": 1,001 values offset + .2, then .1 and .3 in turn, certified S = .1 exactly.
    values = offset + np.concatenate([[0.2], np.tile([0.1, 0.3], 500)])[:, None]
    # The input itself carries only some 1e-16 · offset / .1 of relative precision.
    assert three_sigma(values)[0] == pytest.approx(0.3, rel=1e-15 * offset)


@pytest.mark.parametrize(
    ("n", "low", "high"), [(5, 0.599, 2.874), (10, 0.688, 1.826), (20, 0.760, 1.461), (30, 0.796, 1.344)]
)
def test_intervals_of_sigma_are_the_handbooks(n: int, low: float, high: float) -> None:
    # Factors for the two-sided 95 % interval of a standard deviation, as tabulated in statistical handbooks.
    rng = np.random.default_rng(n)
    result = assess_repeatability([PoseCycles(rng.normal(size=(n, 3)))])[0]
    assert result.interval.x_mm is not None
    assert result.repeatability.x_mm is not None
    assert result.interval.x_mm[0] / result.repeatability.x_mm == pytest.approx(low, abs=6e-4)
    assert result.interval.x_mm[1] / result.repeatability.x_mm == pytest.approx(high, abs=6e-4)


def test_a_sphere_reads_the_maxwell_distributions_figure() -> None:
    # l of a sphere is Maxwell: mean 2 √(2/π) σ, standard deviation √(3 - 8/π) σ; 100,000 cycles know it to .3 %.
    positions = np.random.default_rng(0).normal(size=(100_000, 3))
    expected = 2.0 * math.sqrt(2.0 / math.pi) + 3.0 * math.sqrt(3.0 - 8.0 / math.pi)
    assert position_repeatability(positions) == pytest.approx(expected, rel=0.01)


@pytest.fixture(scope="module")
def ur10(data_folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Joint configurations that Landgraf's UR10 visited twice: differences and tracker deviations of the two, mm.

    Leica laser tracker with T-Mac, 2020, github.com/christianlandgraf/ipa-robot-accuracy (MIT), series B.
    """
    file = data_folder / "ur10_lasertracker" / "Series_B" / "measurements_joint_configurations.csv"
    lines = file.read_text().splitlines()[1:]
    rows = np.array([[float(v.replace(",", ".")) for v in line.split(";")[:26]] for line in lines])
    visits: dict[tuple[float, ...], list[int]] = {}
    for index, joints in enumerate(np.round(rows[:, 7:13], 4)):
        visits.setdefault(tuple(joints), []).append(index)
    pairs = np.array([v for v in visits.values() if len(v) == 2])
    differences = rows[pairs[:, 0]][:, [14, 16, 18]] - rows[pairs[:, 1]][:, [14, 16, 18]]
    deviations = rows[pairs][:, :, [15, 17, 19]]
    return differences, deviations


def test_a_ur10_returns_within_its_data_sheet(ur10: tuple[np.ndarray, np.ndarray]) -> None:
    # Universal Robots states ± .1 mm for the UR10. The difference of two returns has twice the scatter of one, so
    # difference / √2 stands for one return about its mean, whatever the configuration.
    differences, deviations = ur10
    assert len(differences) == 39
    variance = (deviations**2).mean(axis=1)
    covariances = np.zeros((39, 6, 6))
    covariances[:, range(3), range(3)] = variance
    result = assess_repeatability([PoseCycles(differences / math.sqrt(2.0), None, covariances)])[0]
    reading, floor = result.repeatability.position_mm, result.noise_floor.position_mm
    assert reading is not None
    assert floor is not None
    assert result.outliers == ()
    assert 0.03 < reading < 0.1
    # The file's deviations are those of the tracker's single samples, of which a reading is the mean. Taken for the
    # reading's own noise they exceed all that was observed, and the verdict says so.
    assert floor > reading
    assert result.verdict is Verdict.BELOW_DETECTION
    scatter = differences.T @ differences / (2.0 * 39)
    pooled = float(long_run_rp(np.linalg.eigvalsh(scatter)[::-1]))
    assert result.interval.position_mm is not None
    assert result.interval.position_mm[0] < pooled < result.interval.position_mm[1]
