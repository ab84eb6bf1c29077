"""Plots of a session: what the analyses found, gathered as plain values and drawn by `app.reports.plots`.

This module loads matplotlib; only the process beside the head imports it, when a plot is asked for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from app.errors import NotFound
from app.records.codec import decode_points
from app.reports.plots.drift import Block, PoseDrift, drift_svg
from app.reports.plots.residual_map import ResidualField, residuals_svg
from app.reports.plots.scatter import PoseScatter, scatter_svg
from app.services.analyses.estimation import FocusGroup, estimate_session
from app.services.analyses.measured import measured_rows, visits_by_pose
from app.services.analyses.outcome import CannotAnalyse
from app.services.analyses.pose_rows import DRIFT_BLOCK, Row
from app.services.analyses.repeatability import pose_rows
from app.services.analyses.snapshot import Snapshot
from core import TargetSpec
from core.camera import Camera, project
from core.metrology import drift

MOST_ROWS = 40
"""Poses or focus groups of one picture."""
OUTLIER = 6.0
"""Residuals beyond so many times their median distance are no matter of the lens."""


def scatter_plot(snapshot: Snapshot, points: Mapping[str, bytes], settings: Mapping[str, str]) -> bytes:
    """Return what `GET .../repeatability/scatter.svg` answers."""
    source = _source(snapshot, points, settings)
    rows = _chosen(source.rows, settings.get("pose_id"))
    title = f"Position scatter in the {source.frame}, about each pose's mean ({source.how})"
    return scatter_svg([_scatter(row, source) for row in rows], title)


def drift_plot(snapshot: Snapshot, points: Mapping[str, bytes], settings: Mapping[str, str]) -> bytes:
    """Return what `GET .../repeatability/drift.svg` answers."""
    source = _source(snapshot, points, settings)
    rows = _chosen(source.rows, settings.get("pose_id"))
    poses = [drifting for row in rows if (drifting := _drift(row)) is not None]
    if not poses:
        raise CannotAnalyse(
            "too_few_cycles",
            "No pose has two measurements with a cycle number, so that there is no course over the cycles to draw.",
            "Tag them with their cycle; for drift by the standard, 20 cycles or more of each pose.",
        )
    return drift_svg(poses, f"Drift over the cycles, in the {source.frame} ({source.how})", DRIFT_BLOCK)


def residual_map(snapshot: Snapshot, points: Mapping[str, bytes], settings: Mapping[str, str]) -> bytes:
    """Return what `GET .../intrinsics/residuals.svg` answers."""
    wanted = settings.get("focus_group")
    if wanted is not None and wanted not in {image.focus_group for image in snapshot.images}:
        raise NotFound(
            "None of the session's measured images is of that focus group.",
            "GET the session's intrinsics for the focus groups there are.",
            code="focus_group_not_found",
        )
    session = estimate_session(snapshot, points, settings["estimator"])
    groups = [group for group in session.groups if wanted in (None, group.name)]
    if not groups:
        reasons = Counter(e.code for e in session.excluded.values())
        raise CannotAnalyse(
            "nothing_usable",
            f"No image of focus group {wanted!r} serves: {_listed(reasons)}.",
            "GET the session's intrinsics for the reasons.",
        )
    if len(groups) > MOST_ROWS:
        raise _too_many(len(groups), "focus groups", "focus_group")
    title = f"Residuals over the image (estimator {settings['estimator']})"
    return residuals_svg([_residuals(group, snapshot, points) for group in groups], title)


@dataclass(frozen=True, slots=True)
class _Source:
    """Whoever measured: its rows, the position of every measurement, and the noise (mm²) of those that state it."""

    rows: Sequence[Row[Any]]
    positions_mm: Mapping[str, Float[np.ndarray, "3"]]
    noise_mm2: Mapping[str, Float[np.ndarray, "3 3"]]
    frame: str
    how: str


def _source(snapshot: Snapshot, points: Mapping[str, bytes], settings: Mapping[str, str]) -> _Source:
    if settings["source"] == "measured_poses":
        visits = visits_by_pose(snapshot)
        found = {visit.measurement_id: visit for of_pose in visits.values() for visit in of_pose}
        return _Source(
            measured_rows(visits),
            {name: visit.position_mm for name, visit in found.items()},
            {name: v.covariance[:3, :3] for name, v in found.items() if v.covariance is not None},
            "instrument's frame",
            "poses measured by another instrument",
        )
    session = estimate_session(snapshot, points, settings["estimator"])
    return _Source(
        pose_rows(snapshot, session),
        {e.measurement_id: e.position_mm for e in session.images},
        {e.measurement_id: e.scatter[:3, :3] for e in session.images},
        "target frame",
        f"estimator {settings['estimator']}",
    )


def _chosen(rows: Sequence[Row[Any]], pose_id: str | None) -> Sequence[Row[Any]]:
    """Return the rows to draw: all, or one pose's; raises CannotAnalyse for none, too many, or nothing in them."""
    if pose_id is not None:
        rows = [row for row in rows if row.pose_id == pose_id]
        if not rows:
            raise CannotAnalyse(
                "too_few_measurements",
                f"Nothing is measured yet of pose {pose_id}.",
                "Upload images of it, or wait until they are measured.",
            )
    if len(rows) > MOST_ROWS:
        raise _too_many(len(rows), "poses", "pose_id")
    if not any(row.images for row in rows):
        reasons = Counter(e.code for row in rows for e in row.excluded)
        raise CannotAnalyse(
            "nothing_usable",
            f"No image of {'this pose' if len(rows) == 1 else 'these poses'} counts: {_listed(reasons)}.",
            "Look at the measurements' failures and overlays; show the whole grid, sharp, evenly lit, and tilted.",
        )
    return rows


def _too_many(count: int, what: str, parameter: str) -> CannotAnalyse:
    return CannotAnalyse(
        "too_many_to_draw",
        f"The session has {count} {what}; one picture shows {MOST_ROWS}.",
        f"Name one of them with {parameter}=.",
    )


def _listed(reasons: Mapping[str, int]) -> str:
    return ", ".join(f"{code} ({count})" for code, count in sorted(reasons.items()))


def _scatter(row: Row[Any], source: _Source) -> PoseScatter:
    counted = [e.measurement_id for e in row.images]
    positions = _stacked([source.positions_mm[name] for name in counted])
    left_out = [e.measurement_id for e in row.excluded if e.code.endswith("_outlier")]
    noise = [source.noise_mm2[name] for name in counted if name in source.noise_mm2]
    figures = row.figures
    return PoseScatter(
        pose_id=row.pose_id,
        positions_mm=positions,
        left_out_mm=_stacked([source.positions_mm[name] for name in left_out]),
        observed_mm2=np.cov(positions, rowvar=False) if len(positions) > 1 else None,
        noise_mm2=np.mean(noise, axis=0) if counted and len(noise) == len(counted) else None,
        reading_mm=figures.repeatability.position_mm if figures else None,
        interval_mm=figures.interval.position_mm if figures else None,
        floor_mm=figures.noise_floor.position_mm if figures else None,
        corrected_mm=figures.corrected.position_mm if figures else None,
        verdict=figures.verdict if figures else "too_few_cycles",
        remark="" if counted else f"no image counts: {_listed(Counter(e.code for e in row.excluded))}",
    )


def _stacked(positions: Sequence[Float[np.ndarray, "3"]]) -> Float[np.ndarray, "n 3"]:
    return np.array(positions, dtype=np.float64).reshape(-1, 3)


def _drift(row: Row[Any]) -> PoseDrift | None:
    visits = [visit for visit in row.images if visit.cycle is not None]
    if len(visits) < 2:
        return None
    positions = _stacked([visit.position_mm for visit in visits])
    cycles = np.array([visit.cycle for visit in visits])
    blocks = []
    if len(visits) >= 2 * DRIFT_BLOCK:
        for block in drift(positions, block=DRIFT_BLOCK).blocks:
            part = slice(block.first_cycle - 1, block.last_cycle)
            spread = positions[part].std(axis=0, ddof=1) / np.sqrt(len(positions[part]))
            first, last = cycles[part][[0, -1]].tolist()
            blocks.append(Block(first, last, block.mean_position_mm, spread, block.repeatability_mm))
    return PoseDrift(row.pose_id, cycles, positions, tuple(blocks))


def _residuals(group: FocusGroup, snapshot: Snapshot, points: Mapping[str, bytes]) -> ResidualField:
    """Return observed less predicted of every point, by the estimate as it stands."""
    seen, left = [], []
    targets = [TargetSpec(**target) for target in snapshot.targets]
    estimate = group.estimate
    for k, image in enumerate(e.image for e in group.images):
        view = decode_points(
            points[image.measurement_id], [], targets[image.target], image.width_px, image.height_px
        )
        rotation = estimate.rotations[k]
        points_camera = (view.points_target - estimate.positions_mm[k]) @ rotation
        seen.append(view.points_px)
        left.append(view.points_px - project(points_camera, Camera.from_array(estimate.cameras[k])))
    observed, residuals = np.concatenate(seen), np.concatenate(left)
    distance = np.linalg.norm(residuals, axis=1)
    counts = distance <= OUTLIER * np.median(distance)
    first = group.images[0].image
    return ResidualField(
        group.name,
        len(group.images),
        first.width_px,
        first.height_px,
        observed[counts],
        residuals[counts],
        int(np.count_nonzero(~counts)),
    )
