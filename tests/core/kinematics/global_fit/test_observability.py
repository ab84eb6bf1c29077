"""The five indices: what each is of the singular values, and which poses each prefers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.kinematics.global_fit.observability import observability_indices


def test_indices_of_known_singular_values() -> None:
    found = observability_indices(np.array([8.0, 4.0, 2.0]), 16)
    assert found.o1 == pytest.approx(1.0)  # the cube root of 64, over the root of 16
    assert found.o2 == pytest.approx(0.25)
    assert found.o3 == pytest.approx(2.0)
    assert found.o4 == pytest.approx(0.5)
    assert found.o5 == pytest.approx(1.0 / (1.0 / 8.0 + 1.0 / 4.0 + 1.0 / 2.0))


def test_each_index_sees_what_the_others_do_not() -> None:
    def of(*values: float) -> tuple[float, ...]:
        found = observability_indices(np.array(values), 1)
        return found.o1, found.o2, found.o3, found.o4, found.o5

    narrow, wide = of(4.0, 2.0, 2.0), of(16.0, 4.0, 1.0)
    # The volume of the second is smaller, its worst direction worse.
    assert wide[0] > narrow[0]
    assert all(a < b for a, b in zip(wide[1:], narrow[1:], strict=True))
    # A larger largest value alone harms shape and amplification, and helps nothing but volume and sum.
    longer = of(8.0, 2.0, 2.0)
    assert longer[1] < narrow[1]
    assert longer[2] == narrow[2]
    assert longer[3] < narrow[3]
    assert longer[4] > narrow[4]


def test_repeating_poses_leaves_o1_and_o2_and_raises_the_others() -> None:
    values = np.array([8.0, 4.0, 2.0])
    once, four_times = observability_indices(values, 10), observability_indices(2.0 * values, 40)
    assert four_times.o1 == pytest.approx(once.o1)
    assert four_times.o2 == pytest.approx(once.o2)
    for name in ("o3", "o4", "o5"):
        assert getattr(four_times, name) == pytest.approx(2.0 * getattr(once, name))


def test_what_is_not_determined_makes_all_but_the_volume_zero() -> None:
    found = observability_indices(np.array([3.0, 0.0]), 4)
    assert (found.o2, found.o3, found.o4, found.o5) == (0.0, 0.0, 0.0, 0.0)
    assert math.isfinite(found.o1)
    assert found.o1 < 1e-100
