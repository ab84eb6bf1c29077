"""Cycles of several poses of known process: steady ones, and ones that drift, step, wander or stop at two points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from core.metrology import PoseSeries
from core.session import MeasuredPose, SessionData

SIGMA_MM = 0.1 / 3.616
"""A sphere of this standard deviation has RP_l .1 mm."""
Cycles = np.ndarray
NOISE = 1e-6 * np.eye(6)


def gaussian(rng: np.random.Generator, n: int, poses: int = 5) -> Cycles:
    return SIGMA_MM * rng.standard_normal((n, poses, 3))


def student(rng: np.random.Generator, n: int, poses: int = 5, nu: float = 4.0) -> Cycles:
    return gaussian(rng, n, poses) / np.sqrt(rng.chisquare(nu, (n, poses, 1)) / nu)


def needles(rng: np.random.Generator, n: int, poses: int = 5) -> Cycles:
    return gaussian(rng, n, poses) * np.array([1.0, 0.02, 0.02])


def correlated(rng: np.random.Generator, n: int, poses: int = 5, phi: float = 0.8) -> Cycles:
    x = gaussian(rng, n, poses)
    for t in range(1, n):
        x[t] = phi * x[t - 1] + np.sqrt(1.0 - phi * phi) * x[t]
    return x


def common_drift(rng: np.random.Generator, n: int, poses: int = 5, length_mm: float = 0.05) -> Cycles:
    return gaussian(rng, n, poses) + np.linspace(0.0, length_mm, n)[:, None, None] * _direction(rng, 1)


def own_drifts(rng: np.random.Generator, n: int, poses: int = 5, length_mm: float = 0.2) -> Cycles:
    return gaussian(rng, n, poses) + np.linspace(0.0, length_mm, n)[:, None, None] * _direction(rng, poses)


def one_drift(rng: np.random.Generator, n: int, poses: int = 5, length_mm: float = 0.2) -> Cycles:
    x = gaussian(rng, n, poses)
    x[:, 1] += np.linspace(0.0, length_mm, n)[:, None] * _direction(rng, 1)[0]
    return x


def common_step(rng: np.random.Generator, n: int, poses: int = 5, length_mm: float = 0.08) -> Cycles:
    return gaussian(rng, n, poses) + length_mm * (np.arange(n) >= 20)[:, None, None] * _direction(rng, 1)


def two_points(rng: np.random.Generator, n: int, poses: int = 5, apart: float = 9.0) -> Cycles:
    x = gaussian(rng, n, poses)
    x[:, 2] += apart * SIGMA_MM * (rng.random(n) < 0.5)[:, None] * _direction(rng, 1)[0]
    return x


STEADY: dict[str, Callable[..., Cycles]] = {"Gauss": gaussian, "Student t4": student, "needles": needles}


def series_of(x: Cycles) -> list[PoseSeries]:
    """Return the series of each pose, its cycles numbered from 1, its mean far from the origin."""
    n, poses = x.shape[:2]
    return [PoseSeries(x[:, i] + 500.0 * (i + 1), np.arange(1, n + 1)) for i in range(poses)]


def measured_session(x: Cycles, *, numbered: bool = True, instrument: bool = True) -> SessionData:
    """Return these cycles as another instrument read them, 100 mm apart; `instrument`: its noise is stated."""
    n, poses = x.shape[:2]
    measured = tuple(
        MeasuredPose(
            f"m{i}-{c}",
            f"P{i + 1}",
            c + 1 if numbered else None,
            None,
            x[c, i] + 100.0 * (i + 1),
            np.eye(3),
            NOISE if instrument else None,
            NOISE if instrument else None,
        )
        for i in range(poses)
        for c in range(n)
    )
    return SessionData((), (), measured=measured)


def _direction(rng: np.random.Generator, count: int) -> np.ndarray:
    v = rng.standard_normal((count, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))
