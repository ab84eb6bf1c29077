"""Sessions of a robot that visits five ISO cube poses of one orientation, before a board that departs from its grid."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from core.geometry import (
    Camera,
    project,
    so3_exp,
    transform,
    transform_points,
)
from core.session import (
    ImageObservation,
    SessionData,
    group_views,
)
from core.targets import GridPoints, TargetSpec

WIDTH, HEIGHT, FOCAL = 2448, 2050, 2320.0
TYPICAL = Camera(FOCAL, FOCAL, 0.5 * WIDTH, 0.5 * HEIGHT, -0.1, 0.05, 0.0, 0.0)
DIAGONALS = np.array([[0, 0, 0], [1, 1, 1], [-1, -1, 1], [1, -1, -1], [-1, 1, -1]], dtype=np.float64)


@dataclass(frozen=True)
class Departure:
    """What a print departs by; lengths in mm, the others relative or rad. `stated` is u(pitch) / pitch."""

    name: str
    bow_mm: float = 0.0
    x_scale: float = 0.0
    shear: float = 0.0
    pitch: float = 0.0
    point_mm: float = 0.0
    stated: float | None = None


DEPARTURES = (
    Departure("perfect"),
    Departure("bow .05 mm", bow_mm=0.05),
    Departure("bow .2 mm", bow_mm=0.2),
    Departure("x-scale .05 %", x_scale=5e-4),
    Departure("skew 5e-4", shear=5e-4),
    Departure("pitch .1 %, stated", pitch=1e-3, stated=1e-3),
    Departure("points .01 mm", point_mm=0.01),
)


@dataclass(frozen=True)
class Setup:
    """A board, the half edge of the cube, the tilt of its views, cycles, and the number of tilted views near the cube,
    which are visited in every cycle as well.
    """

    columns: int = 14
    rows: int = 10
    pitch_mm: float = 20.0
    half_edge_mm: float = 110.0
    tilt_deg: float = 30.0
    cycles: int = 10
    tilted_views: int = 0
    noise_px: float = 0.05
    scatter_mm: float = 0.03


def printed(target: TargetSpec, departure: Departure, rng: np.random.Generator) -> np.ndarray:
    """Return where the points of the print are, (n, 3) mm."""
    points = target.points_target()
    middle = points.mean(axis=0)
    x, y, _ = (points - middle).T
    signs = rng.choice([-1.0, 1.0], 4)
    xi, eta = x / np.max(x), y / np.max(y)
    about = np.column_stack(
        [
            x * (1.0 + signs[0] * departure.x_scale) + 0.5 * signs[1] * departure.shear * y,
            y + 0.5 * signs[1] * departure.shear * x,
            departure.bow_mm * (signs[2] * xi**2 + signs[3] * eta**2) / math.sqrt(2.0),
        ]
    )
    about *= 1.0 + departure.pitch
    about[:, :2] += departure.point_mm * rng.standard_normal((len(points), 2))
    return middle + about


def simulate(
    rng: np.random.Generator, setup: Setup, departure: Departure
) -> tuple[SessionData, dict[str, np.ndarray]]:
    """Return a session, and by pose the camera's true mean position in the target frame."""
    stated = None if departure.stated is None else departure.stated * setup.pitch_mm
    target = TargetSpec(
        "chessboard", setup.columns, setup.rows, setup.pitch_mm, pitch_standard_uncertainty_mm=stated
    )
    camera = Camera(
        FOCAL * math.exp(rng.normal(0.0, 0.03)),
        0.0,
        0.5 * WIDTH + rng.normal(0.0, 15.0),
        0.5 * HEIGHT + rng.normal(0.0, 15.0),
        *(rng.normal([-0.1, 0.05], 0.03)),
        *(rng.normal(0.0, 2e-4, 2)),
    )
    camera = Camera(camera.fx_px, camera.fx_px * math.exp(rng.normal(0.0, 3e-4)), *camera.as_array()[2:8])
    print_mm = printed(target, departure, rng)
    middle = print_mm.mean(axis=0)
    extent = float(np.max(np.ptp(print_mm, axis=0)))
    depth = FOCAL * extent / (0.45 * WIDTH)
    poses = {}
    turn = rng.uniform(0.0, 2.0 * math.pi)
    axes = so3_exp(np.array([0.0, 0.0, rng.uniform(0.0, 2.0 * math.pi)]))
    R = _looking(turn, math.radians(setup.tilt_deg), rng.uniform(-0.4, 0.4))
    for i, d in enumerate(DIAGONALS):
        poses[f"P{i + 1}"] = transform(
            R.T, middle - R.T @ ([0.0, 0.0, depth] + setup.half_edge_mm * (axes @ d))
        )
    for i in range(setup.tilted_views):
        tilted = _looking(
            turn + math.pi * (0.25 + 0.5 * i), math.radians(15.0 + 25.0 * (i % 4) / 3.0), 0.5 * math.pi * i
        )
        poses[f"V{i + 1}"] = transform(tilted.T, middle - tilted.T @ np.array([0.0, 0.0, depth]))
    row, column = (a.ravel() for a in np.mgrid[0 : setup.rows, 0 : setup.columns])
    images, points, true = [], {}, {}
    for name, T in poses.items():
        visits = []
        for cycle in range(1, setup.cycles + 1):
            at = T.copy()
            at[:3, 3] += rng.normal(0.0, setup.scatter_mm, 3)
            at[:3, :3] = so3_exp(rng.normal(0.0, 5e-5, 3)) @ at[:3, :3]
            visits.append(at[:3, 3])
            pixels = project(transform_points(np.linalg.inv(at), print_mm), camera)
            pixels = pixels + rng.normal(0.0, setup.noise_px, pixels.shape)
            seen = np.all((pixels > 0.0) & (pixels < [WIDTH - 1, HEIGHT - 1]), axis=1)
            points[len(images)] = GridPoints(
                target,
                WIDTH,
                HEIGHT,
                column[seen],
                row[seen],
                pixels[seen],
                np.full(int(seen.sum()), setup.noise_px),
            )
            key = f"{name}-{cycle}"
            images.append(ImageObservation(key, name, cycle, key, 0, "default", None, WIDTH, HEIGHT))
        true[name] = np.mean(visits, axis=0)
    data = SessionData((target,), ("board",), images=tuple(images), views=group_views(tuple(images), points))
    return data, true


def _looking(direction: float, tilt: float, roll: float) -> np.ndarray:
    """Return R_camera_target of a view tilted about an axis in the board, and rolled."""
    axis = np.array([math.cos(direction), math.sin(direction), 0.0])
    return so3_exp(np.array([0.0, 0.0, roll])) @ so3_exp(tilt * axis)
