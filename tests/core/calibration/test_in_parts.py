"""Two threads give what one gives, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration import in_parts
from core.calibration.estimators import GroupEstimate
from tests.core.calibration.test_estimators import estimate, session


@pytest.mark.parametrize("bow_mm", [0.0, 0.5])
def test_results_do_not_depend_on_the_number_of_threads(
    monkeypatch: pytest.MonkeyPatch, bow_mm: float
) -> None:
    s = session(7, cycles=4, bow_mm=bow_mm)

    def at(worth_it: int) -> GroupEstimate:
        monkeypatch.setattr(in_parts, "WORTH_IT", worth_it)
        return estimate(s, "pooled")

    one, two = at(10**9), at(1)
    for name in ("positions_mm", "rotations", "covariance", "scatter", "common", "camera_covariance"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_every_part_is_done_once_and_failures_come_out() -> None:
    done: list[tuple[int, int]] = []
    in_parts.in_two_parts(lambda begin, end: done.append((begin, end)), 7, in_parts.WORTH_IT)
    assert sorted(done) == [(0, 3), (3, 7)]
    done.clear()
    in_parts.in_two_parts(lambda begin, end: done.append((begin, end)), 7, in_parts.WORTH_IT - 1)
    assert done == [(0, 7)]
    with pytest.raises(ZeroDivisionError):
        in_parts.in_two_parts(lambda begin, _end: [1 // (begin - 3)].clear(), 7, in_parts.WORTH_IT)
