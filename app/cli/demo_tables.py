"""Estimates beside the truth: the demo's tables, which fit into 80 columns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich.markup import escape
from rich.table import Table

from app.agent import Json
from core.simulation import SessionImage
from core.transforms import so3_log


@dataclass(frozen=True, slots=True)
class Comparison:
    """One image's estimate, its stated uncertainty, and how far from the truth it is.

    Uncertainties and errors of position (mm) and rotation (°) are lengths of vectors; a ratio is
    sqrt(eᵀ Σ⁻¹ e / 3), 1 in the root mean square where Σ is the truth about e.
    """

    name: str
    position_mm: tuple[float, float, float]
    position_uncertainty_mm: float
    position_error_mm: float
    position_ratio: float
    roll_pitch_yaw_deg: tuple[float, float, float]
    rotation_uncertainty_deg: float
    rotation_error_deg: float
    rotation_ratio: float
    focal_px: float
    focal_uncertainty_px: float
    focal_error_px: float


def compare(image: SessionImage, measurement: Json) -> Comparison:
    """Return a calibrated measurement beside its image's truth."""
    calibration = measurement["calibration"]
    pose, intrinsics = calibration["pose"], calibration["intrinsics"]
    covariance = np.array(pose["covariance"])
    truth = image.true_T_target_camera
    position_error = np.array(pose["position_mm"]) - truth[:3, 3]
    rotation_error = so3_log(truth[:3, :3] @ np.array(pose["rotation"]).T)
    x, y, z = pose["position_mm"]
    return Comparison(
        name=f"{image.pose_id}/c{image.cycle}",
        position_mm=(x, y, z),
        position_uncertainty_mm=_length(covariance[:3, :3]),
        position_error_mm=float(np.linalg.norm(position_error)),
        position_ratio=_ratio(position_error, covariance[:3, :3]),
        roll_pitch_yaw_deg=(pose["roll_deg"], pose["pitch_deg"], pose["yaw_deg"]),
        rotation_uncertainty_deg=math.degrees(_length(covariance[3:, 3:])),
        rotation_error_deg=math.degrees(float(np.linalg.norm(rotation_error))),
        rotation_ratio=_ratio(rotation_error, covariance[3:, 3:]),
        focal_px=intrinsics["fx_px"],
        focal_uncertainty_px=calibration["standard_uncertainty"]["fx_px"],
        focal_error_px=intrinsics["fx_px"] - image.scene.camera.fx_px,
    )


def position_table(rows: Sequence[Comparison]) -> Table:
    """Return where the camera was, in the target's frame."""
    table = _table(
        "Camera position in the target frame, mm", "image", "x", "y", "z", "± u", "error", "error/u"
    )
    for r in rows:
        x, y, z = (f"{value:.2f}" for value in r.position_mm)
        table.add_row(
            r.name,
            x,
            y,
            z,
            f"{r.position_uncertainty_mm:.2f}",
            f"{r.position_error_mm:.2f}",
            f"{r.position_ratio:.1f}",
        )
    return table


def rotation_table(rows: Sequence[Comparison]) -> Table:
    """Return how the camera was turned, and its focal length."""
    names = ("image", "roll", "pitch", "yaw", "± u", "error", "error/u", "f px", "± u", "error")
    table = _table("Camera orientation, degrees, and focal length, px", *names)
    for r in rows:
        angles = (f"{value:.3f}" for value in r.roll_pitch_yaw_deg)
        table.add_row(
            r.name,
            *angles,
            f"{r.rotation_uncertainty_deg:.3f}",
            f"{r.rotation_error_deg:.3f}",
            f"{r.rotation_ratio:.1f}",
            f"{r.focal_px:.1f}",
            f"{r.focal_uncertainty_px:.1f}",
            f"{r.focal_error_px:+.1f}",
        )
    return table


def refusal_table(measurements: Sequence[Json]) -> Table:
    """Return the images that got no answer, with the reason and the way out."""
    table = Table(
        title="Refused, rather than answered wrongly",
        title_justify="left",
        title_style="bold",
        pad_edge=False,
    )
    for name in ("image", "why", "what to do"):
        table.add_column(name, overflow="fold")
    for m in measurements:
        failure = m["failure"]
        why = f"{failure['code']}: {failure['detail']}"
        table.add_row(f"{m['pose_id']}/c{m['cycle']}", escape(why), escape(failure["advice"] or ""))
    return table


def _table(title: str, first: str, *others: str) -> Table:
    table = Table(
        title=title, title_justify="left", title_style="bold", box=None, padding=(0, 2, 0, 0), pad_edge=False
    )
    table.add_column(first)
    for name in others:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _length(covariance: np.ndarray) -> float:
    return math.sqrt(float(np.trace(covariance)))


def _ratio(error: np.ndarray, covariance: np.ndarray) -> float:
    return math.sqrt(float(error @ np.linalg.solve(covariance, error)) / len(error))
