"""Cycles drawn from known truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from core.geometry.roll_pitch_yaw import rpy_to_rotation
from core.geometry.se3 import so3_exp
from core.metrology import PoseCycles

MakeCycles = Callable[..., PoseCycles]


@pytest.fixture(scope="session")
def make_cycles() -> MakeCycles:
    def make(
        n: int = 30,
        seed: int = 0,
        robot_mm: float = 0.03,
        robot_rad: float = 1e-4,
        noise_mm: float = 0.004,
        noise_rad: float = 2e-5,
        roll_pitch_yaw: tuple[float, float, float] = (0.3, -0.4, 1.2),
    ) -> PoseCycles:
        rng = np.random.default_rng(seed)
        sigma = np.hypot([robot_mm] * 3 + [robot_rad] * 3, [noise_mm] * 3 + [noise_rad] * 3)
        draws = rng.standard_normal((n, 6)) * sigma
        mean = rpy_to_rotation(np.array(roll_pitch_yaw))
        covariance = np.diag([noise_mm**2] * 3 + [noise_rad**2] * 3)
        return PoseCycles(
            np.array([400.0, -250.0, 900.0]) + draws[:, :3],
            np.array([so3_exp(w) @ mean for w in draws[:, 3:]]),
            np.repeat(covariance[None], n, axis=0),
        )

    return make
