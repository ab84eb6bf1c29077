"""Uncertainty of a pose against distance in a standard set-up, for docs/instruments.md: from one image by itself, from
one image of a session, and between visits of one pose.

The set-up: the standard camera (2448 x 2050 px, f 2320 px), a chessboard of 14 x 10 corners 300 mm wide, tilted by 15°
to 40° to any side, and ten poses a session at one distance. Corners are simulated with noise of two sizes: that of a
sharp image of an exact board, and that which the residuals of photographs of printed boards have. Errors are against
the simulated truth: lengths of the error vector, rms over all images.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from benchmarks.table import Row
from core.calibration import calibrate_points, estimate_group
from core.errors import FocalNotObservable
from core.geometry import invert, project, so3_exp, so3_log, transform, transform_points
from core.targets import GridPoints
from tests.support.simulation.scenes import standard_camera, standard_target

DISTANCES_MM = (500.0, 750.0, 1000.0, 1500.0, 2000.0)
NOISE_PX = {"sharp, exact board": 0.01, "photographs of prints": 0.1}
TILTS = (math.radians(15.0), math.radians(40.0))
POSES, SESSIONS_A_SEED, QUICK_SESSIONS = 10, 3, 1
SIZE_PX = (2448, 2050)
KINDS = ("visits of one pose", "image of a session", "image by itself")
_MARGIN_PX = 20.0


@dataclass(frozen=True, slots=True)
class _Seen:
    """Errors and stated standard uncertainties of poses; mm and rad, lengths of vectors, one for each image."""

    position_mm: list[float]
    rotation: list[float]
    stated_position_mm: list[float]
    stated_rotation: list[float]
    scatter_mm: list[float]
    scatter_rotation: list[float]


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    for name, sigma_px in NOISE_PX.items():
        for distance_mm in DISTANCES_MM:
            pooled, alone = _Seen([], [], [], [], [], []), _Seen([], [], [], [], [], [])
            asked = 0
            for seed in seeds:
                rng = np.random.default_rng([seed, round(distance_mm), 33])
                for _ in range(QUICK_SESSIONS if quick else SESSIONS_A_SEED):
                    truth = [_view(distance_mm, rng) for _ in range(POSES)]
                    views = [_points(T, sigma_px, rng) for T in truth]
                    asked += len(views)
                    _of_session(views, truth, pooled)
                    _of_images(views, truth, alone)
            where = _where(name, sigma_px, distance_mm)
            yield _row(f"{where}: {KINDS[0]}", pooled.scatter_mm, pooled.scatter_rotation, "stated")
            yield _row(f"{where}: {KINDS[1]}", pooled.position_mm, pooled.rotation, "error", pooled)
            refused = asked - len(alone.position_mm)
            yield _row(f"{where}: {KINDS[2]}", alone.position_mm, alone.rotation, "error", alone, refused)


def table_of(rows: Iterable[Row]) -> str:
    """Return the table of docs/instruments.md from this section's rows: one line for each noise and distance."""
    lines = [
        "| noise of a corner, px | distance | " + " | ".join(KINDS) + " |",
        "|" + "---|" * (2 + len(KINDS)),
    ]
    measured = {row.what: row.measured for row in rows}
    for name, sigma_px in NOISE_PX.items():
        for distance_mm in DISTANCES_MM:
            cells = [measured[f"{_where(name, sigma_px, distance_mm)}: {kind}"] for kind in KINDS]
            lines.append(f"| {sigma_px:g} | {distance_mm / 1000.0:g} m | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _where(name: str, sigma_px: float, distance_mm: float) -> str:
    return f"{name} ({sigma_px:g} px), {distance_mm / 1000.0:g} m"


def _row(
    what: str,
    position_mm: list[float],
    rotation: list[float],
    kind: str,
    stated: _Seen | None = None,
    refused: int = 0,
) -> Row:
    degrees = math.degrees(_rms(rotation))
    note = f"rms {kind}, {len(position_mm)} images"
    if stated is not None:
        note += f"; stated {_rms(stated.stated_position_mm):.3g} mm, "
        note += f"{math.degrees(_rms(stated.stated_rotation)):.2g}°"
    if refused:
        note += f"; {refused} refused, focal length not observable"
    return Row(what, f"{_rms(position_mm):.3g} mm, {degrees:.2g}°", note=note)


def _view(distance_mm: float, rng: np.random.Generator) -> np.ndarray:
    """Return a T_camera_target at the distance that shows the whole board, as far from the middle as fits."""
    target, camera = standard_target(14, 10), standard_camera()
    grid = target.points_target()
    middle = 0.5 * (grid.min(axis=0) + grid.max(axis=0))
    axis_angle, tilt = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(*TILTS)
    R = so3_exp(tilt * np.array([math.cos(axis_angle), math.sin(axis_angle), 0.0]))
    R = R @ so3_exp(np.array([0.0, 0.0, rng.uniform(-math.pi, math.pi)]))
    half_field = 0.5 * np.array(SIZE_PX) / camera.fx_px * distance_mm
    for reach in np.linspace(1.0, 0.0, 21):
        shift = reach * half_field * rng.uniform(-1.0, 1.0, 2)
        T_camera_target = transform(R, np.array([*shift, distance_mm]) - R @ middle)
        pixels = project(transform_points(T_camera_target, grid), camera)
        if np.all((pixels > _MARGIN_PX) & (pixels < np.array(SIZE_PX) - _MARGIN_PX)):
            return T_camera_target
    raise AssertionError("The board fits into the image at every distance of the set-up.")


def _points(T_camera_target: np.ndarray, sigma_px: float, rng: np.random.Generator) -> GridPoints:
    target = standard_target(14, 10)
    row, column = (a.ravel() for a in np.mgrid[0 : target.rows, 0 : target.columns])
    exact = project(transform_points(T_camera_target, target.points_target()), standard_camera())
    noisy = exact + rng.normal(0.0, sigma_px, exact.shape)
    return GridPoints(target, *SIZE_PX, column, row, noisy, np.full(len(noisy), sigma_px))


def _of_session(views: list[GridPoints], truth: list[np.ndarray], seen: _Seen) -> None:
    found = estimate_group(views, "pooled")
    for k, image in enumerate(found.images.tolist()):
        _add(seen, found.positions_mm[k], found.rotations[k], found.covariance[k], truth[image])
        seen.scatter_mm.append(math.sqrt(float(np.trace(found.scatter[k, :3, :3]))))
        seen.scatter_rotation.append(math.sqrt(float(np.trace(found.scatter[k, 3:, 3:]))))


def _of_images(views: list[GridPoints], truth: list[np.ndarray], seen: _Seen) -> None:
    for points, T_camera_target in zip(views, truth, strict=True):
        try:
            pose = calibrate_points(points).pose
        except FocalNotObservable:
            continue
        _add(seen, pose.position_mm, pose.rotation, pose.covariance, T_camera_target)


def _add(
    seen: _Seen,
    position_mm: np.ndarray,
    rotation: np.ndarray,
    covariance: np.ndarray,
    T_camera_target: np.ndarray,
) -> None:
    """Append one pose of the camera in the target frame."""
    T_target_camera = invert(T_camera_target)
    seen.position_mm.append(float(np.linalg.norm(position_mm - T_target_camera[:3, 3])))
    seen.rotation.append(float(np.linalg.norm(so3_log(rotation @ T_target_camera[:3, :3].T))))
    seen.stated_position_mm.append(math.sqrt(float(np.trace(covariance[:3, :3]))))
    seen.stated_rotation.append(math.sqrt(float(np.trace(covariance[3:, 3:]))))


def _rms(values: list[float]) -> float:
    return math.sqrt(float(np.mean(np.square(values)))) if values else math.nan
