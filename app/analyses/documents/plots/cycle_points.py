"""The cycles of each pose as points about their mean, for drawings that a reader can turn and read off."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from app.records.numbers import encode
from core.session import PoseRow, SessionData, estimate_session, image_rows, measured_rows


def cycle_points(data: SessionData, settings: Mapping[str, str]) -> bytes:
    """Return for every pose its cycles' positions about the mean, which are outliers, and the noise's ellipsoid."""
    if settings["source"] == "measured_poses":
        rows = measured_rows(data).rows
    else:
        rows = image_rows(data, estimate_session(data, settings["estimator"])).rows
    return encode({"poses": [_pose(row) for row in rows]})


def _pose(row: PoseRow) -> dict[str, Any]:
    visits = row.visits
    positions = np.array([visit.position_mm for visit in visits], dtype=np.float64).reshape(-1, 3)
    outliers = {one.index for one in row.figures.outliers} if row.figures else set()
    noise = [visit.scatter[:3, :3] for visit in visits if visit.scatter is not None]
    return {
        "pose_id": row.pose_id,
        "cycles": [visit.cycle for visit in visits],
        "offsets_mm": _rounded(positions - positions.mean(axis=0)) if visits else [],
        "outlier": [index in outliers for index in range(len(visits))],
        "noise_mm2": np.mean(noise, axis=0).tolist() if noise and len(noise) == len(visits) else None,
        "observed_mm2": np.cov(positions, rowvar=False).tolist() if len(visits) > 1 else None,
    }


def _rounded(positions: Float[np.ndarray, "n 3"]) -> list[list[float]]:
    found: list[list[float]] = np.round(positions, 7).tolist()
    return found
