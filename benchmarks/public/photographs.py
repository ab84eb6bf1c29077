"""Calibration from many photographs: OpenCV, mrcal and Gridpose on the same grid points, side by side.

Projection uncertainty is mrcal's figure: the standard deviation, in its worst direction, of where a far point is
projected, if noise of the corners propagates to intrinsics and board poses, and the boards are what does not move
(https://mrcal.secretsauce.net/uncertainty.html). For OpenCV and Gridpose it is computed here by the same definition
from the Jacobian at their solutions; mrcal computes its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import cv2
import numpy as np

from benchmarks.images.photographs import SETS, detected
from core.calibration import calibrate_views
from core.geometry import Camera, hats, project, project_with_jacobian, so3_exp, transform, undistort_points
from core.targets import GridPoints

SYSTEM_PYTHON = Path("/usr/bin/python3")
HOW_TO_INSTALL = "mrcal has not been run. To add it on Debian or Ubuntu: apt-get install python3-mrcal"
MRCAL_RUNS = {"mrcal": False, "mrcal, bow of the board estimated": True}
FREE = 8  # fx, fy, cx, cy, k1, k2, p1, p2: the model of all three
_REPEATS = 5
_SOLVER = Path(__file__).with_name("mrcal_solver.py")


class MrcalFailed(Exception):
    """mrcal ended without an answer; the message is the last line that it wrote."""


@dataclass(frozen=True, slots=True)
class Answer:
    """One calibration: mean focal length, rms residual, projection uncertainty at the centre and the median over the
    image, px; seconds of the solve, its start included."""

    focal_px: float
    rms_px: float
    at_centre_px: float
    over_image_px: float
    seconds: float


def calibration_table(folder: Path) -> str:
    """Return a Markdown table of every set of photographs in a folder; a sentence where the folder has no such set."""
    has_mrcal = mrcal_is_installed()
    lines = []
    for name, (pattern, _) in SETS.items():
        if not list(folder.glob(pattern)):
            continue
        views = detected(folder, name)
        answers = {"Gridpose": by_gridpose(views), "OpenCV": by_opencv(views)}
        lines += [_line(name, views, who, answer) for who, answer in answers.items()]
        for who, warp in MRCAL_RUNS.items() if has_mrcal else ():
            try:
                lines.append(_line(name, views, who, by_mrcal(views, warp=warp)))
            except MrcalFailed as failure:
                lines.append(f"| {name}, {len(views)} | {who} | failed: {failure} | | | | |")
        print(f"{name}: calibrated.", flush=True)
    if not lines:
        return f"No photographs in {folder}: `benchmarks/public/README.md` lists the sets.\n"
    head = (
        "| photographs | by | f, px | rms, px | u at the centre, px | u, median of the image, px | time |\n"
    )
    note = "" if has_mrcal else f"\n{HOW_TO_INSTALL}\n"
    return head + "|" + "---|" * 7 + "\n" + "\n".join(lines) + "\n" + note


def _line(name: str, views: Sequence[GridPoints], who: str, answer: Answer) -> str:
    figures = f"{answer.focal_px:.2f} | {answer.rms_px:.3f} | {answer.at_centre_px:.3f} | {answer.over_image_px:.3f}"
    return f"| {name}, {len(views)} | {who} | {figures} | {1e3 * answer.seconds:.1f} ms |"


def mrcal_is_installed() -> bool:
    """Return whether the system's interpreter has mrcal."""
    if not SYSTEM_PYTHON.exists():
        return False
    asked = subprocess.run(
        [SYSTEM_PYTHON, "-c", "import mrcal"], capture_output=True, env=_clean(), check=False
    )
    return asked.returncode == 0


def by_gridpose(views: Sequence[GridPoints]) -> Answer:
    """Calibrate by `core.calibration.calibrate_views`; its uncertainty has its inflation for correlated residuals."""
    calibrate_views(views)  # compiles
    seconds = median(_timed(lambda: calibrate_views(views)) for _ in range(_REPEATS))
    found = calibrate_views(views)
    spread = projection_uncertainty(
        found.camera,
        [T for T, used in zip(found.T_camera_target, found.used, strict=True) if used.any()],
        [v.points_target[used] for v, used in zip(views, found.used, strict=True) if used.any()],
        [v.standard_uncertainty_px[used] for v, used in zip(views, found.used, strict=True) if used.any()],
        [r[used] for r, used in zip(found.residuals_px, found.used, strict=True) if used.any()],
        _query(views[0]),
    )
    spread *= found.inflation
    focal = 0.5 * (found.camera.fx_px + found.camera.fy_px)
    return Answer(focal, found.rms_px / np.sqrt(2.0), spread[0], float(np.median(spread)), seconds)


def by_opencv(views: Sequence[GridPoints]) -> Answer:
    """Calibrate by cv2.calibrateCamera, k3 held at 0."""
    size = views[0].image_width_px, views[0].image_height_px
    objects = [v.points_target.astype(np.float32) for v in views]
    points = [v.points_px.astype(np.float32) for v in views]

    def solve() -> tuple[float, np.ndarray, np.ndarray, Sequence[np.ndarray], Sequence[np.ndarray]]:
        return cv2.calibrateCamera(objects, points, size, None, None, flags=cv2.CALIB_FIX_K3)  # type: ignore[call-overload]

    seconds = median(_timed(solve) for _ in range(_REPEATS))
    _, K, lens, rotations, translations = solve()
    camera = Camera(*(float(v) for v in (K[0, 0], K[1, 1], K[0, 2], K[1, 2], *lens.ravel()[:4])))
    poses = [
        transform(so3_exp(np.ravel(r)), np.ravel(t)) for r, t in zip(rotations, translations, strict=True)
    ]
    targets = [v.points_target for v in views]
    residuals = [
        v.points_px - project(X @ T[:3, :3].T + T[:3, 3], camera)
        for v, X, T in zip(views, targets, poses, strict=True)
    ]
    ones = [np.ones(len(v)) for v in views]
    spread = projection_uncertainty(camera, poses, targets, ones, residuals, _query(views[0]))
    rms = float(np.sqrt(np.mean(np.concatenate(residuals) ** 2)))
    return Answer(float(K[0, 0] + K[1, 1]) / 2.0, rms, spread[0], float(np.median(spread)), seconds)


def by_mrcal(views: Sequence[GridPoints], *, warp: bool) -> Answer:
    """Calibrate by mrcal in the system's interpreter; its time is of seed and solve, without the program's start.

    Raises MrcalFailed.
    """
    target = views[0].target
    grid = np.full((len(views), target.grid_rows, target.grid_columns, 2), np.nan)
    for k, view in enumerate(views):
        grid[k, view.row, view.column] = view.points_px
    problem = {
        "points_px": np.where(np.isfinite(grid), grid, None).tolist(),
        "spacing": target.pitch_mm,
        "size_px": [views[0].image_width_px, views[0].image_height_px],
        "warp": warp,
        "query_px": _query(views[0]).tolist(),
    }
    answer = subprocess.run(
        [SYSTEM_PYTHON, _SOLVER],
        input=json.dumps(problem),
        capture_output=True,
        text=True,
        env=_clean(),
        check=False,
    )
    if answer.returncode != 0:
        raise MrcalFailed((answer.stderr.strip().splitlines() or ["no reason given"])[-1])
    found = json.loads(answer.stdout)
    spread = np.array(found["projection_uncertainty_px"])
    return Answer(found["focal_px"], found["rms_px"], spread[0], float(np.median(spread)), found["seconds"])


def projection_uncertainty(
    camera: Camera,
    T_camera_target: Sequence[np.ndarray],
    points_target: Sequence[np.ndarray],
    relative_sigma: Sequence[np.ndarray],
    residuals_px: Sequence[np.ndarray],
    query_px: np.ndarray,
) -> np.ndarray:
    """Return the standard deviation (n,), px, of the projection of far points seen at `query_px`, worst direction.

    The far point turns with the mean of the boards: δq = ∂q/∂k δk + ∂q/∂v (mean of the boards' δθ) × v. Noise is that
    of the residuals, for points of the stated relative standard deviations.
    """
    size = FREE + 6 * len(T_camera_target)
    normal, squares, count = np.zeros((size, size)), 0.0, 0
    for k, (T, X, sigma, residuals) in enumerate(
        zip(T_camera_target, points_target, relative_sigma, residuals_px, strict=True)
    ):
        turned = X @ T[:3, :3].T
        by_point, by_camera = _derivatives(turned + T[:3, 3], camera)
        J = np.zeros((len(X), 2, FREE + 6))
        J[:, :, :FREE] = by_camera
        J[:, :, FREE : FREE + 3] = -by_point @ hats(turned)
        J[:, :, FREE + 3 :] = by_point
        J /= sigma[:, None, None]
        J = J.reshape(-1, FREE + 6)
        own = np.concatenate([np.arange(FREE), FREE + 6 * k + np.arange(6)])
        normal[np.ix_(own, own)] += J.T @ J
        squares += float(np.sum((residuals / sigma[:, None]) ** 2))
        count += 2 * len(X)
    scale = 1.0 / np.sqrt(np.diag(normal))  # parameters differ by many powers of ten
    covariance = (
        np.linalg.inv(normal * np.outer(scale, scale)) * np.outer(scale, scale) * squares / (count - size)
    )
    directions = np.column_stack([undistort_points(query_px, camera), np.ones(len(query_px))])
    by_point, by_camera = _derivatives(directions, camera)
    G = np.zeros((len(query_px), 2, size))
    G[:, :, :FREE] = by_camera
    turning = -by_point @ hats(directions) / len(T_camera_target)
    for k in range(len(T_camera_target)):
        G[:, :, FREE + 6 * k : FREE + 6 * k + 3] = turning
    return np.asarray(np.sqrt(np.linalg.eigvalsh(G @ covariance @ G.transpose(0, 2, 1))[:, -1]))


def _derivatives(points_camera: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of the pixels by the points (n, 2, 3) and by the free camera parameters (n, 2, 8)."""
    _, by_camera, by_point = project_with_jacobian(points_camera, camera)
    return by_point.transpose(2, 1, 0), by_camera[:FREE].transpose(2, 1, 0)


def _query(view: GridPoints) -> np.ndarray:
    """Return the image's centre, then places all over it, px."""
    width, height = view.image_width_px, view.image_height_px
    u, v = np.meshgrid(np.linspace(0.05, 0.95, 10) * width, np.linspace(0.05, 0.95, 8) * height)
    centre = [[0.5 * (width - 1), 0.5 * (height - 1)]]
    return np.concatenate([centre, np.stack([u.ravel(), v.ravel()], axis=1)])


def _timed(call: object) -> float:
    started = time.process_time()
    assert callable(call)
    call()
    return time.process_time() - started


def _clean() -> dict[str, str]:
    """Return the environment without what would lead the system's interpreter to this one's packages."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
