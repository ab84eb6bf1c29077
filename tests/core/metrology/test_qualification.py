"""Known lengths: errors, the scale they show, the uncertainty of the test value, and decisions on a limit."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest

from core.errors import InvalidArgument
from core.metrology import Decision, KnownLength, PoseCycles, qualify

PLACES = {"A": 0.0, "B": 100.0, "C": 250.0, "D": 400.0}


def at(
    place_mm: float, visits: int = 5, *, noise_mm: float = 0.0, rng: np.random.Generator | None = None
) -> PoseCycles:
    positions = np.tile([place_mm, 0.0, 0.0], (visits, 1))
    if rng is not None:
        positions = positions + rng.normal(0.0, noise_mm, positions.shape)
    return PoseCycles(positions)


def test_a_scale_error_is_seen_in_every_length_and_named() -> None:
    lengths = [
        (KnownLength("A", name, PLACES[name], 0.001), at(0.0), at(PLACES[name] * 1.0004)) for name in "BCD"
    ]
    found = qualify(lengths, 0.05)
    assert [one.error_mm for one in found.errors] == pytest.approx([0.04, 0.1, 0.16])
    assert found.scale_ppm == pytest.approx(400.0)
    assert found.worst.known.to_pose_id == "D"
    assert found.decision is Decision.FAIL
    assert found.probing_scatter_mm == 0.0


@pytest.mark.parametrize(
    ("error", "decision"),
    [
        (0.02, Decision.PASS),
        (0.045, Decision.INCONCLUSIVE),
        (-0.055, Decision.INCONCLUSIVE),
        (-0.08, Decision.FAIL),
    ],
)
def test_a_limit_is_decided_on_with_the_uncertainty_of_the_test_value(
    error: float, decision: Decision
) -> None:
    known = KnownLength("A", "B", 100.0, 0.005)
    found = qualify([(known, at(0.0), at(100.0 + error))], 0.05)
    assert found.decision is decision
    low, high = found.errors[0].interval_mm
    assert (low, high) == pytest.approx((error - 1.96 * 0.005, error + 1.96 * 0.005), abs=1e-5)
    assert qualify([(known, at(0.0), at(100.0))]).decision is None


def test_many_lengths_at_the_limit_fail_no_more_often_than_one() -> None:
    """Ten lengths between five poses, all exactly at the limit, ten visits, 300 times: at the whole risk each, 18 %."""
    rng = np.random.default_rng(2)
    places = np.array([[0, 0, 0], [100, 100, 100], [-100, 100, 100], [-100, -100, -100], [100, -100, -100.0]])
    failed = []
    for _ in range(300):
        poses = [PoseCycles(place + rng.normal(0.0, 0.05, (10, 3))) for place in places]
        lengths = []
        for i, j in combinations(range(5), 2):
            true = float(np.linalg.norm(places[i] - places[j])) - 0.1
            known = KnownLength(f"P{i}", f"P{j}", true + rng.normal(0.0, 0.01), 0.01)
            lengths.append((known, poses[i], poses[j]))
        failed.append(qualify(lengths, 0.1).decision is Decision.FAIL)
    assert np.mean(failed) < 0.025 + 3.0 * math.sqrt(0.025 * 0.975 / 300)


def test_intervals_of_errors_hold_with_few_visits() -> None:
    """600 lengths of a perfect instrument, three visits an end: four standard deviations about 95 %."""
    rng = np.random.default_rng(12)
    inside = []
    for _ in range(600):
        true = 200.0
        stated = true + rng.normal(0.0, 0.004)
        ends = at(0.0, 3, noise_mm=0.01, rng=rng), at(true, 3, noise_mm=0.01, rng=rng)
        low, high = qualify([(KnownLength("A", "B", stated, 0.004), *ends)]).errors[0].interval_mm
        inside.append(low <= 0.0 <= high)
    assert abs(np.mean(inside) - 0.95) < 4.0 * math.sqrt(0.95 * 0.05 / 600)


@pytest.mark.parametrize("shared", [True, False])
def test_the_scale_is_as_uncertain_as_it_says_where_lengths_share_a_pose(shared: bool) -> None:
    """Six lengths of a stage, from one zero or each from its own: rms of error over uncertainty, 400 times."""
    rng = np.random.default_rng(21)
    z = []
    for _ in range(400):
        zero = at(0.0, noise_mm=0.02, rng=rng)
        lengths = [
            (
                KnownLength("A", f"B{true:.0f}", true + rng.normal(0.0, 0.002), 0.002),
                zero if shared else at(0.0, noise_mm=0.02, rng=rng),
                at(true, noise_mm=0.02, rng=rng),
            )
            for true in np.arange(50.0, 301.0, 50.0)
        ]
        found = qualify(lengths)
        z.append(found.scale_ppm / found.scale_standard_uncertainty_ppm)
    # 28 or 48 degrees of freedom of the scatter add 4 or 2 %; three standard errors of the rms are 11 %.
    assert math.sqrt(float(np.mean(np.square(z)))) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(
    ("visits", "most"),
    [(2, 1.35), (3, 1.25), (10, 1.15)],
)
@pytest.mark.parametrize("shape", [(1.0, 1.0, 1.0), (0.2, 0.2, 1.0)])
def test_the_scale_from_few_visits_is_as_uncertain_as_it_says(
    visits: int, most: float, shape: tuple[float, ...]
) -> None:
    """Seven lengths between six poses, 400 times: by the directions in which twelve readings scatter, 1.8 and 1.5."""
    rng = np.random.default_rng(31)
    places = rng.uniform(-300.0, 300.0, (6, 3))
    z = []
    for _ in range(400):
        poses = [PoseCycles(place + rng.normal(0.0, 0.03, (visits, 3)) * np.array(shape)) for place in places]
        lengths = []
        for first, second in ((0, 1), (0, 2), (0, 3), (0, 4), (0, 5), (1, 3), (2, 5)):
            stated = np.linalg.norm(places[second] - places[first]) + rng.normal(0.0, 0.002)
            known = KnownLength(f"P{first}", f"P{second}", float(stated), 0.002)
            lengths.append((known, poses[first], poses[second]))
        found = qualify(lengths)
        z.append(found.scale_ppm / found.scale_standard_uncertainty_ppm)
    rms = math.sqrt(float(np.mean(np.square(z))))
    # Six degrees of freedom of the scatter add a fifth by themselves.
    assert 0.6 < rms < most


def test_one_visit_counts_where_the_instrument_says_how_sure_it_is() -> None:
    alone = PoseCycles(np.array([[100.0, 0.0, 0.0]]), None, 0.03**2 * np.eye(6)[None])
    found = qualify([(KnownLength("A", "B", 100.0, 0.04), at(0.0), alone)])
    assert found.errors[0].standard_uncertainty_mm == pytest.approx(0.05)
    with pytest.raises(InvalidArgument, match="one visit"):
        qualify([(KnownLength("A", "B", 100.0, 0.01), at(0.0, 1), at(100.0))])


def test_what_cannot_be_a_length_is_refused() -> None:
    for wrong in (
        ("A", "A", 1.0, 0.1),
        ("A", "B", 0.0, 0.1),
        ("A", "B", math.nan, 0.1),
        ("A", "B", 1.0, -0.1),
    ):
        with pytest.raises(InvalidArgument):
            KnownLength(*wrong)
    with pytest.raises(InvalidArgument):
        qualify([])
    with pytest.raises(InvalidArgument, match="same place"):
        qualify([(KnownLength("A", "B", 1.0, 0.1), at(0.0), at(0.0))])
    with pytest.raises(InvalidArgument, match="uncertainty"):
        qualify([(KnownLength("A", "B", 1.0, 0.0), at(0.0), at(1.0))])
