"""Plain values that plots are drawn of, odd ones included."""

from __future__ import annotations

from typing import Any

import numpy as np

from app.reports.camera_plots.coverage_cells import ProjectionField, coverage_cells
from app.reports.camera_plots.residual_cells import ResidualField
from app.reports.drift import Block, PoseDrift
from app.reports.scatter import PoseScatter

NOTHING = np.zeros((0, 3))


def scatter(pose_id: str = "P1", n: int = 12, sigma: float = 0.03, **changes: Any) -> PoseScatter:
    rng = np.random.default_rng(n)
    positions = np.array([120.0, 80.0, -400.0]) + sigma * rng.standard_normal((n, 3))
    several = n > 1
    values: dict[str, Any] = {
        "outliers_mm": NOTHING,
        "observed_mm2": np.cov(positions, rowvar=False) if several else None,
        "noise_mm2": np.diag([0.004, 0.005, 0.002]) ** 2,
        "rp_mm": 3.4 * sigma if several else None,
        "interval_mm": (2.7 * sigma, 4.6 * sigma) if several else None,
        "floor_mm": 0.0131 if several else None,
        "corrected_mm": 3.3 * sigma if several else None,
        "verdict": "robot" if n >= 10 else "too_few_cycles",
    }
    return PoseScatter(pose_id, positions, **{**values, **changes})


def motionless(n: int = 10) -> PoseScatter:
    nil = np.zeros((3, 3))
    figures = {"rp_mm": 0.0, "interval_mm": (0.0, 0.0), "floor_mm": 0.0, "corrected_mm": 0.0}
    return scatter("still", n, 0.0, observed_mm2=nil, noise_mm2=nil, verdict="below_detection", **figures)


ODD_SCATTERS = [
    scatter("one-cycle", 1),
    motionless(),
    scatter("nothing-counts", 0, note="no image counts: target_not_found (3)"),
    scatter("outliers", outliers_mm=np.array([[5e4, -2e4, 1.0], [120.01, 80.01, -400.01]])),
    scatter("x" * 128, 8, 40.0),
    scatter("no-covariances", noise_mm2=None, floor_mm=None, corrected_mm=None),
]


def drifting(pose_id: str = "P1", n: int = 30, slope: float = 0.004, sigma: float = 0.02) -> PoseDrift:
    rng = np.random.default_rng(n)
    cycles = np.arange(1, n + 1)
    positions = np.array([120.0, 80.0, -400.0]) + sigma * rng.standard_normal((n, 3))
    positions[:, 0] += slope * cycles
    blocks = []
    for start in range(0, n - 9 if n >= 20 else 0, 10):
        part = positions[start : start + 10]
        error = part.std(axis=0, ddof=1) / np.sqrt(10)
        blocks.append(Block(start + 1, start + 10, part.mean(axis=0), error, 3.4 * sigma))
    return PoseDrift(pose_id, cycles, positions, tuple(blocks))


ODD_DRIFTS = [
    drifting("still", slope=0.0, sigma=0.0),
    drifting("two-cycles", n=2),
    drifting("far", slope=50.0),
    drifting("y" * 128, n=120),
]


def field(name: str = "default", n: int = 4000, bend: float = 0.0, **changes: Any) -> ResidualField:
    """Points all over the image, with noise of .02 px and a distortion left over that grows to the corners."""
    rng = np.random.default_rng(n)
    width, height = changes.get("width_px", 2448), changes.get("height_px", 2050)
    points = rng.uniform(0.0, 1.0, (n, 2)) * (width, height)
    off = 2.0 * points / (width, height) - 1.0
    residuals = 0.02 * rng.standard_normal((n, 2)) + bend * off * np.sum(off * off, axis=1)[:, None]
    values = {"width_px": width, "height_px": height, "outliers": 0, **changes}
    return ResidualField(name, 30, points_px=points, residuals_px=residuals, **values)


ODD_FIELDS = [
    field("cost $5$ and $6$ 焦点", bend=0.02, outliers=12),
    field("tall", 900, width_px=600, height_px=2400),
    field("five points", 5),
    ResidualField("perfect", 1, 640, 480, np.array([[3.0, 4.0]] * 9), np.zeros((9, 2)), 0),
]


def projected(source: ResidualField, sigma: float = 0.05) -> ProjectionField:
    """The cells of a field's points, with an uncertainty that grows from the image's centre."""
    cells = coverage_cells(source.points_px, source.width_px, source.height_px)
    off = 2.0 * cells.middle_px / (source.width_px, source.height_px) - 1.0
    return ProjectionField(
        source.focus_group, source.images, cells, sigma * (0.1 + np.sum(off * off, axis=-1))
    )


ODD_PROJECTIONS = [
    *map(projected, ODD_FIELDS[:3]),
    projected(field("y" * 128), 0.0),
    ProjectionField(
        "fold", 1, (folded := projected(field())).cells, np.full(folded.cells.count.shape, np.nan)
    ),
]
