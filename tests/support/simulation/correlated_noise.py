"""Sessions of a robot before a board, as grid points with noise that is not white: fields, waves, bursts, blur."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.calibration.multi_view.estimators import estimate_group
from core.calibration.multi_view.group_estimate import GroupEstimate
from core.calibration.multi_view.view_stack import ViewStack
from core.geometry.camera import Camera, project
from core.geometry.se3 import so3_exp, transform, transform_points
from core.metrology import PoseCycles, PoseRepeatability, assess_repeatability
from core.session.model import CameraViews, ImageObservation, SessionData
from core.targets.specification import TargetSpec
from tests.support.simulation.simulated_views import draw_camera, draw_pose

BOARD = TargetSpec("chessboard", 14, 10, 20.0)
WIDTH, HEIGHT = 2448, 2050
WHITE_PX = 0.01

Noise = Callable[[np.random.Generator, Float[np.ndarray, "p 2"], float, int], Float[np.ndarray, "m p 2"]]
"""Draws noise (px) of m images, given the points (px) and the spacing of neighbours (px)."""


def white(sigma_px: float = WHITE_PX) -> Noise:
    return lambda rng, points, spacing, count: rng.normal(0.0, sigma_px, (count, *points.shape))


def gaussian_field(squares: float, sigma_px: float = 0.01) -> Noise:
    """Return white noise and a field correlated over so many squares."""

    def draw(
        rng: np.random.Generator, points: Float[np.ndarray, "p 2"], spacing: float, count: int
    ) -> Float[np.ndarray, "m p 2"]:
        distance = np.linalg.norm(points[:, None] - points, axis=2) / (squares * spacing)
        values, vectors = np.linalg.eigh(np.exp(-0.5 * distance**2))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        field = np.einsum("pq,mqc->mpc", root, rng.normal(0.0, sigma_px, (count, *points.shape)))
        return np.asarray(field + rng.normal(0.0, WHITE_PX, field.shape))

    return draw


def row_wave(heights: float, amplitude_px: float = 0.03, *, steady: bool = False) -> Noise:
    """Return white noise and a wave over the rows, in u, of a phase of its own in each image; its amplitude is the same
    in all, or Rayleigh's, of the same mean square: then the wave is a Gaussian field.
    """

    def draw(
        rng: np.random.Generator, points: Float[np.ndarray, "p 2"], spacing: float, count: int
    ) -> Float[np.ndarray, "m p 2"]:
        noise = rng.normal(0.0, WHITE_PX, (count, *points.shape))
        phase = rng.uniform(0.0, 2.0 * math.pi, (count, 1))
        size = np.ones((count, 1)) if steady else rng.rayleigh(math.sqrt(0.5), (count, 1))
        wave = np.sin(2.0 * math.pi * points[:, 1] / (heights * HEIGHT) + phase)
        noise[:, :, 0] += amplitude_px * size * wave
        return noise

    return draw


def in_some_images(usual: Noise, other: Noise, share: float = 0.2) -> Noise:
    """Return the noise of images of which a share, at random, has another noise."""

    def draw(
        rng: np.random.Generator, points: Float[np.ndarray, "p 2"], spacing: float, count: int
    ) -> Float[np.ndarray, "m p 2"]:
        chosen = rng.uniform(size=count) < share
        return np.where(
            chosen[:, None, None], other(rng, points, spacing, count), usual(rng, points, spacing, count)
        )

    return draw


DISTURBANCES: dict[str, Noise] = {
    "white": white(),
    "field of 1 square": gaussian_field(1.0),
    "field of 2 squares": gaussian_field(2.0),
    "field of 5 squares": gaussian_field(5.0),
    "field of 14 squares": gaussian_field(14.0),
    "wave of .2 H": row_wave(0.2),
    "wave of .5 H": row_wave(0.5),
    "wave of 1 H": row_wave(1.0),
    "wave of 2.5 H": row_wave(2.5),
    "wave of 8 H": row_wave(8.0),
    "steady wave of .5 H": row_wave(0.5, steady=True),
    "bursts of a field in 20 % of the images": in_some_images(white(), gaussian_field(2.0, 0.03)),
    "blur in 20 % of the images": in_some_images(white(), white(3.0 * WHITE_PX)),
}


@dataclass(frozen=True)
class NoisySession:
    """Images in one stack, the label of each one's pose, and the camera that took them."""

    views: ViewStack
    labels: list[int]
    camera: Camera
    burst: int = 1


def noisy_session(
    rng: np.random.Generator,
    noise: Noise,
    *,
    poses: int = 5,
    cycles: int = 30,
    robot_mm: float = 0.0,
    target: TargetSpec = BOARD,
    tilt_deg: float = 30.0,
    camera: Camera | None = None,
    slip: tuple[int, float] | None = None,
    burst: int = 1,
    shake_rad: float = 0.0,
) -> NoisySession:
    """Simulate a session; the robot's positions scatter by `robot_mm` along each axis, 0 for one at rest. In image
    `slip[0]` it is displaced by `slip[1]` mm as well. Of each stop there are `burst` images. In every image
    the camera is turned about its centre by `shake_rad` about each axis, which no residual shows.
    """
    camera = camera or draw_camera(rng)
    ideal = target.points_target()
    # Poses are drawn first: sessions of one seed see the same, whatever the noise and however many cycles.
    placements = [draw_pose(rng, target, camera, WIDTH, math.radians(tilt_deg)) for _ in range(poses)]
    points: list[Float[np.ndarray, "p 2"]] = []
    for T in placements:
        exact = project(transform_points(T, ideal), camera)
        grid = exact.reshape(target.grid_rows, target.grid_columns, 2)
        spacing = float(np.median(np.linalg.norm(np.diff(grid, axis=1), axis=2)))
        drawn = noise(rng, exact, spacing, cycles * burst)
        for j in range(cycles * burst):
            if j % burst == 0:
                moved = T.copy()
            if robot_mm and j % burst == 0:
                moved[:3, 3] += rng.normal(0.0, robot_mm, 3)
                moved[:3, :3] = so3_exp(rng.normal(0.0, 1e-6, 3)) @ moved[:3, :3]
            if slip is not None and len(points) == slip[0]:
                moved[0, 3] += slip[1]
            seen = moved
            if shake_rad:
                seen = transform(so3_exp(rng.normal(0.0, shake_rad, 3)), np.zeros(3)) @ moved
            points.append(project(transform_points(seen, ideal), camera) + drawn[j])
    row, column = (a.ravel() for a in np.mgrid[0 : target.grid_rows, 0 : target.grid_columns])
    count = poses * cycles * burst
    views = ViewStack(
        WIDTH,
        HEIGHT,
        (target,),
        np.zeros(count, dtype=np.intp),
        np.arange(count + 1) * len(ideal),
        np.tile(column, count).astype(np.intp),
        np.tile(row, count).astype(np.intp),
        np.ascontiguousarray(np.concatenate(points)),
        np.full(count * len(ideal), WHITE_PX),
        np.tile(ideal, (count, 1)),
    )
    return NoisySession(views, [p for p in range(poses) for _ in range(cycles * burst)], camera, burst)


def estimated(session: NoisySession, estimator: str = "pooled") -> GroupEstimate:
    return estimate_group(session.views, estimator, intrinsics=session.camera, repeats=session.labels)


def figures(session: NoisySession, found: GroupEstimate) -> list[PoseRepeatability]:
    """Return the figures of each pose, in the order of the labels."""
    label = np.array(session.labels)[found.images]
    poses = [np.flatnonzero(label == one) for one in np.unique(label)]
    return assess_repeatability(
        [PoseCycles(found.positions_mm[p], found.rotations[p], found.scatter[p]) for p in poses]
    )


def session_data(session: NoisySession, intrinsics: Camera | None = None) -> SessionData:
    """Return what the service would know of a session: poses P0, P1, ... with cycles from 1 on, and the place of each
    image in its burst where stops have several.
    """
    images, seen = [], dict.fromkeys(session.labels, 0)
    for k, label in enumerate(session.labels):
        cycle, place = divmod(seen[label], session.burst)
        seen[label] += 1
        images.append(
            ImageObservation(
                *(f"m{k}", f"P{label}", cycle + 1, f"{k:064x}", 0, "default", None, WIDTH, HEIGHT),
                burst=place + 1 if session.burst > 1 else None,
            )
        )
    group = CameraViews("default", np.arange(len(images)), session.views)
    return SessionData(session.views.targets, ("board",), tuple(images), (group,), intrinsics=intrinsics)
