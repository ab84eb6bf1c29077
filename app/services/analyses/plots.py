"""Plots of a session: what the analyses found, gathered as plain values and drawn by `app.reports.plots`.

This module loads matplotlib; only the process beside the head imports it, when a plot is asked for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from app.errors import NotFound
from app.records.codec import decode_points
from app.reports.plots.drift import Block, PoseDrift, drift_svg
from app.reports.plots.residual_map import ResidualField, residuals_svg
from app.reports.plots.scatter import PoseScatter, scatter_svg
from app.services.analyses.estimation import EstimatedImage, FocusGroup, SessionEstimate, estimate_session
from app.services.analyses.outcome import CannotAnalyse
from app.services.analyses.pose_rows import DRIFT_BLOCK
from app.services.analyses.repeatability import PoseRow, pose_rows
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
    session = estimate_session(snapshot, points, settings["estimator"])
    found = {e.image.measurement_id: e for e in session.images}
    rows = _chosen(snapshot, session, settings.get("pose_id"))
    if not any(row.images for row in rows):
        raise _nothing(rows)
    return scatter_svg([_scatter(row, found) for row in rows], settings["estimator"])


def drift_plot(snapshot: Snapshot, points: Mapping[str, bytes], settings: Mapping[str, str]) -> bytes:
    """Return what `GET .../repeatability/drift.svg` answers."""
    session = estimate_session(snapshot, points, settings["estimator"])
    rows = _chosen(snapshot, session, settings.get("pose_id"))
    if not any(row.images for row in rows):
        raise _nothing(rows)
    poses = [drifting for row in rows if (drifting := _drift(row)) is not None]
    if not poses:
        raise CannotAnalyse(
            "too_few_cycles",
            "No pose has two images with a cycle number, so that there is no course over the cycles to draw.",
            "Tag the images with their cycle; for drift by the standard, 20 cycles or more of each pose.",
        )
    return drift_svg(poses, settings["estimator"], DRIFT_BLOCK)


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
    return residuals_svg([_residuals(group, snapshot, points) for group in groups], settings["estimator"])


def _chosen(snapshot: Snapshot, session: SessionEstimate, pose_id: str | None) -> Sequence[PoseRow]:
    rows = pose_rows(snapshot, session)
    if pose_id is not None:
        rows = [row for row in rows if row.pose_id == pose_id]
        if not rows:
            raise CannotAnalyse(
                "too_few_measurements",
                f"Pose {pose_id} has no measured image yet.",
                "Upload images of it, or wait until they are measured.",
            )
    if len(rows) > MOST_ROWS:
        raise _too_many(len(rows), "poses", "pose_id")
    return rows


def _too_many(count: int, what: str, parameter: str) -> CannotAnalyse:
    return CannotAnalyse(
        "too_many_to_draw",
        f"The session has {count} {what}; one picture shows {MOST_ROWS}.",
        f"Name one of them with {parameter}=.",
    )


def _nothing(rows: Sequence[PoseRow]) -> CannotAnalyse:
    reasons = Counter(e.code for row in rows for e in row.excluded)
    return CannotAnalyse(
        "nothing_usable",
        f"No image of {'this pose' if len(rows) == 1 else 'these poses'} counts: {_listed(reasons)}.",
        "Look at the measurements' failures and overlays; show the whole grid, sharp, evenly lit, and tilted.",
    )


def _listed(reasons: Mapping[str, int]) -> str:
    return ", ".join(f"{code} ({count})" for code, count in sorted(reasons.items()))


def _positions(images: Sequence[EstimatedImage]) -> np.ndarray:
    return np.array([e.position_mm for e in images]).reshape(-1, 3)


def _scatter(row: PoseRow, found: Mapping[str, EstimatedImage]) -> PoseScatter:
    positions = _positions(row.images)
    figures = row.figures
    left_out = [found[e.measurement_id] for e in row.excluded if e.code.endswith("_outlier")]
    reasons = Counter(e.code for e in row.excluded)
    return PoseScatter(
        pose_id=row.pose_id,
        positions_mm=positions,
        left_out_mm=_positions(left_out),
        observed_mm2=np.cov(positions, rowvar=False) if len(positions) > 1 else None,
        noise_mm2=np.mean([e.scatter[:3, :3] for e in row.images], axis=0) if row.images else None,
        reading_mm=figures.repeatability.position_mm if figures else None,
        interval_mm=figures.interval.position_mm if figures else None,
        floor_mm=figures.noise_floor.position_mm if figures else None,
        corrected_mm=figures.corrected.position_mm if figures else None,
        verdict=figures.verdict if figures else "too_few_cycles",
        remark="" if row.images else f"no image counts: {_listed(reasons)}",
    )


def _drift(row: PoseRow) -> PoseDrift | None:
    images = [e for e in row.images if e.image.cycle is not None]
    if len(images) < 2:
        return None
    positions = _positions(images)
    cycles = np.array([e.image.cycle for e in images])
    blocks = []
    if len(images) >= 2 * DRIFT_BLOCK:
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
