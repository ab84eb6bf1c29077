"""Plain values that plots are drawn of, odd ones included."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from app.reports.arm_schematic import (
    JointAxis,
    LinkPart,
    UndeterminedGroup,
    arm_schematic_figure,
)
from app.reports.camera_plots.coverage_cells import ProjectionField, coverage_cells
from app.reports.camera_plots.lens_profile import LensProfile, lens_profile_figure
from app.reports.camera_plots.projection_map import projection_figure
from app.reports.camera_plots.radial_bins import RadialResiduals
from app.reports.camera_plots.residual_cells import ResidualField, cells_of
from app.reports.camera_plots.residual_map import residuals_figure
from app.reports.drift import Block, BlockMean, PoseDrift, drift_figure
from app.reports.joint_curves import JointCurvePanel, joint_curves_figure
from app.reports.scatter import PoseScatter, scatter_figure
from app.reports.steadiness import SteadinessPanel, steadiness_figure
from app.reports.workspace_map import (
    EXTRAPOLATED,
    MapPanel,
    MarkedPlace,
    PlaceCell,
    workspace_map_figure,
)

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


def drifting(
    pose_id: str = "P1",
    n: int = 30,
    slope: float = 0.004,
    sigma: float = 0.02,
    *,
    turns: bool = False,
    minutes: float = 0.0,
) -> PoseDrift:
    """Cycles along a straight line; with orientations that scatter, and a time for each cycle, where asked."""
    rng = np.random.default_rng(n)
    cycles = np.arange(1, n + 1)
    positions = np.array([120.0, 80.0, -400.0]) + sigma * rng.standard_normal((n, 3))
    positions[:, 0] += slope * cycles
    angles = 0.002 * rng.standard_normal((n, 3)) if turns else None
    blocks = []
    for start in range(0, n - 9 if n >= 20 else 0, 10):
        part = slice(start, start + 10)
        turn = None if angles is None else block_mean(angles[part], start)
        blocks.append(Block(start + 1, start + 10, block_mean(positions[part], start), 3.4 * sigma, turn))
    hours = cycles * minutes / 60.0 if minutes else None
    return PoseDrift(pose_id, cycles, positions, tuple(blocks), angles, hours, 0.8 * sigma, 0.0011)


def block_mean(part: np.ndarray, start: int) -> BlockMean:
    error = part.std(axis=0, ddof=1) / np.sqrt(len(part))
    return BlockMean(part.mean(axis=0), error, 2.9 * error * bool(start))


ODD_DRIFTS = [
    drifting("still", slope=0.0, sigma=0.0),
    drifting("two-cycles", n=2),
    drifting("far", slope=50.0),
    drifting("y" * 128, n=120),
    drifting("turned over an hour", turns=True, minutes=2.5),
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


def steady_or_not(name: str = "P1", *, steady: bool = False) -> SteadinessPanel:
    """A series of 30 cycles: steady, or with a trend, a step, and visits at a second stopping point."""
    offsets = 0.02 * np.random.default_rng(5).standard_normal((30, 3))
    line = None if steady else np.array([[-0.05, 0.01, 0.0], [0.05, -0.01, 0.0]])
    return SteadinessPanel(
        name,
        "p 0.0012",
        "moved 103.2 ± 10.1 µm by its trend (chance alone: up to 31 µm)",
        steady,
        np.arange(1, 31),
        offsets,
        line,
        None if steady else 12,
        np.zeros(30, dtype=bool) if steady else np.arange(30) % 5 == 0,
        0.03,
    )


STEADINESS = [
    steady_or_not("common to all poses", steady=True),
    steady_or_not("z" * 128),
    steady_or_not("P2", steady=True),
]


def joint_panels() -> list[JointCurvePanel]:
    """Two joints, one with angles that were never visited."""
    angles = np.linspace(-170.0, 170.0, 69)
    curve = 0.004 * np.sin(np.radians(angles))
    return [
        JointCurvePanel("joint 1", angles, curve, np.full(69, 0.001), angles[::3], []),
        JointCurvePanel("joint 2", angles, -curve, np.full(69, 0.002), angles[::5], [(-0.3, 40.0)]),
    ]


def workspace_map() -> Figure:
    """A map of two panels, visited in part, with values beyond the scale."""
    cells = [
        PlaceCell(50.0 * i + 25.0, 50.0 * j, (0.1 * i + 0.02 * j, 0.05 * i), (i + j) % 5 == 0, i > 6)
        for i in range(10)
        for j in range(-6, 8)
    ]
    panels = [
        MapPanel("median of the configurations", "position error, mm", 0.7),
        MapPanel("u", "u, mm", 0.3),
    ]
    marked = MarkedPlace(
        225.0, 150.0, ("Median 0.300 mm;", "largest (×) 0.640 mm at radius 225 mm.", EXTRAPOLATED)
    )
    return workspace_map_figure(cells, 50.0, panels, marked, "title")


def arm_schematic() -> Figure:
    """An arm of three joints, five parameters of which are not determined, some at one place."""
    places = np.array([[0.0, 0, 0], [0, 0, 400], [180, 0, 400], [180, 0, 1000], [300, 40, 1000]])
    axes = [JointAxis(i + 1, places[i], np.eye(3)[2 - i]) for i in range(3)]
    names = ("d1", "a1", "a2", "tool")
    parts = [LinkPart(name, places[i], places[i + 1]) for i, name in enumerate(names)]
    groups = [
        UndeterminedGroup(
            "A", (("d1", places[1] / 2.0), ("θ1", places[0]), ("base", places[0])), "words " * 40
        ),
        UndeterminedGroup("B", (("θ2", places[1]), ("θ3", places[2])), "they coincide."),
        UndeterminedGroup("C", (("tool", places[4]), ("α3", places[4])), "positions alone."),
    ]
    return arm_schematic_figure(axes, parts, groups, "title")


def slender_arm_schematic() -> Figure:
    """An upright arm with a short base, whose second axis ends next to the base's tags."""
    places = np.array([[0.0, 0, 0], [0, 0, 127], [100, 0, 700], [250, 0, 1200], [400, 0, 1250]])
    leaning = np.array([0.5, 0.85, 0.1]) / np.linalg.norm([0.5, 0.85, 0.1])
    axes = [JointAxis(1, places[0], np.eye(3)[2]), *(JointAxis(i + 1, places[i], leaning) for i in (1, 2))]
    parts = [LinkPart(name, places[i], places[i + 1]) for i, name in enumerate(("d1", "a2", "a3", "tool"))]
    groups = [
        UndeterminedGroup("A", (("d1", places[1] / 2.0), ("θ1", places[0]), ("base", places[0])), "words"),
        UndeterminedGroup("C", (("d2", places[1]), ("d3", places[2])), "they are parallel."),
    ]
    return arm_schematic_figure(axes, parts, groups, "title")


def crowded_arm_schematic() -> Figure:
    """An arm whose last link is at the height of the tool, in which three groups have a parameter."""
    places = np.array([[0.0, 0, 0], [0, 0, 400], [180, 0, 400], [900, 0, 430], [1020, 0, 400]])
    axes = [JointAxis(i + 1, places[i], np.eye(3)[2 - i]) for i in range(3)]
    parts = [LinkPart(name, places[i], places[i + 1]) for i, name in enumerate(("d1", "a1", "a2", "tool"))]
    tool = ("tool", places[4])
    groups = [
        UndeterminedGroup("A", (("θ1", places[0]), ("base", places[0])), "words"),
        UndeterminedGroup("B", (("a6", places[3]), ("α6", places[3]), tool), "they coincide."),
        *(UndeterminedGroup(letter, (tool,), "positions alone.") for letter in "CD"),
    ]
    return arm_schematic_figure(axes, parts, groups, "title")


def lens_profiles() -> list[LensProfile]:
    """Three lens models of a focus group, one of which turns back within the observed radius."""
    radius = np.linspace(1.0, 900.0, 900)
    models = [
        RadialResiduals(name, radius, slope * radius + 0.02 * np.cos(radius), 0.1, fold)
        for name, slope, fold in (
            *(("brown", 1e-4, 950.0), ("kannala_brandt", 0.0, None)),
            ("rational", -5e-5, None),
        )
    ]
    return [LensProfile("default", 30, "kannala_brandt", "w 41, share 2.0 %.", 900.0, models)]


DRAWINGS: dict[str, Callable[[], Figure]] = {
    "scatter": lambda: scatter_figure([scatter()], "title"),
    "odd scatters": lambda: scatter_figure(ODD_SCATTERS, "title"),
    "drift": lambda: drift_figure([drifting()], "title", 10),
    "odd drifts": lambda: drift_figure(ODD_DRIFTS, "title", 10),
    "residuals": lambda: residuals_figure([(bent := field(bend=0.02))], [cells_of(bent)], "title"),
    "odd residuals": lambda: residuals_figure(ODD_FIELDS, [cells_of(f) for f in ODD_FIELDS], "title"),
    "projection": lambda: projection_figure([projected(field(n=30))], "title"),
    "odd projections": lambda: projection_figure(ODD_PROJECTIONS, "title"),
    "one drift in time": lambda: drift_figure([drifting(turns=True, minutes=4.0)], "title", 10),
    "steadiness": lambda: steadiness_figure(STEADINESS, "title", "not steady", "cycle"),
    "one steadiness": lambda: steadiness_figure(STEADINESS[1:2], "title", "not steady", "cycle"),
    "joint curves": lambda: joint_curves_figure(joint_panels(), "title", "chosen"),
    "workspace map": workspace_map,
    "arm schematic": arm_schematic,
    "slender arm": slender_arm_schematic,
    "crowded arm": crowded_arm_schematic,
    "lens models": lambda: lens_profile_figure(lens_profiles(), "title"),
}
"""Every kind of plot, and the odd ones."""
