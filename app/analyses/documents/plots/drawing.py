"""Plots of a session: what the analyses found, gathered as plain values and drawn by `app.reports`.

This module loads matplotlib. Only the analysis process imports it, when a plot is requested.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from app.analyses.documents.camera.projection_field import projection_field
from app.analyses.documents.camera.residual_field import residual_field
from app.analyses.documents.plots.pose_drift import pose_drift
from app.analyses.documents.plots.steadiness_panels import steadiness_panels, steadiness_summary
from app.analyses.outcome import AnalysisError
from app.errors import NotFound
from app.reports.camera_plots.projection_map import projection_svg
from app.reports.camera_plots.residual_map import residuals_svg
from app.reports.drift import drift_svg
from app.reports.forms import words
from app.reports.scatter import PoseScatter, common_half_width, scatter_svg
from app.reports.steadiness import steadiness_svg
from core.errors import NothingUsable, TooFewCycles, TooFewMeasurements
from core.session import (
    DRIFT_BLOCK,
    FocusGroup,
    PoseRow,
    SessionData,
    SessionSteadiness,
    estimate_session,
    image_rows,
    measured_rows,
    with_print_uncertainty,
)

Shown = TypeVar("Shown")

MAX_ROWS = 40
"""Poses or focus groups of one plot."""


def scatter_plot(data: SessionData, settings: Mapping[str, str], about: str) -> bytes:
    """Return what `GET .../repeatability/scatter.svg` answers."""
    return scatter_pages(data, settings, about)[0]


def scatter_pages(
    data: SessionData, settings: Mapping[str, str], about: str, poses_a_page: int | None = None
) -> list[bytes]:
    """Return the same on pages of so many poses at most, all on one scale; on one page by default."""
    source = _source(data, settings)
    wanted = settings.get("pose_id")
    # One visit has no scatter: such poses are drawn where there is no other, or where one is asked for.
    repeated = [row for row in source.rows if len(row.visits) > 1]
    rows = _chosen(source.rows if wanted is not None or not repeated else repeated, wanted)
    title = f"Positions about each pose's mean, in the {source.frame} ({source.how})"
    poses = [_scatter(row) for row in rows]
    half = common_half_width(poses)
    return [scatter_svg(page, title, about, half_width_mm=half) for page in _pages(poses, poses_a_page)]


def drift_plot(data: SessionData, settings: Mapping[str, str], about: str) -> bytes:
    """Return what `GET .../repeatability/drift.svg` answers."""
    return drift_pages(data, settings, about)[0]


def drift_pages(
    data: SessionData, settings: Mapping[str, str], about: str, poses_a_page: int | None = None
) -> list[bytes]:
    """Return the same on pages of so many poses at most; on one page by default."""
    source = _source(data, settings)
    rows = _chosen(source.rows, settings.get("pose_id"))
    poses = [drifting for row in rows if (drifting := pose_drift(row, data)) is not None]
    if not poses:
        raise TooFewCycles(
            "No pose has two measurements with a cycle number, so that there is no course over the cycles to draw.",
            "Tag them with their cycle; for drift by the standard, 20 cycles or more of each pose.",
        )
    title = f"Drift over the cycles, in the {source.frame} ({source.how})"
    return [drift_svg(page, title, DRIFT_BLOCK, about) for page in _pages(poses, poses_a_page)]


def steadiness_plot(data: SessionData, settings: Mapping[str, str], about: str) -> bytes:
    """Return what `GET .../repeatability/steadiness.svg` answers; poses are chosen after all of them are tested."""
    return steadiness_pages(data, settings, about)[0]


def steadiness_pages(
    data: SessionData, settings: Mapping[str, str], about: str, panels_a_page: int | None = None
) -> list[bytes]:
    """Return the same on pages of so many panels at most; on one page by default."""
    source = _source(data, settings)
    rows = _chosen(source.rows, settings.get("pose_id"))
    panels = steadiness_panels(source.steadiness, [row.pose_id for row in rows])
    grid = source.steadiness.found.grid
    counted_in = "visit" if grid is not None and grid.by_visit else "cycle"
    title = f"Steadiness of the cycles, in the {source.frame} ({source.how})"
    summary = steadiness_summary(source.steadiness)
    return [steadiness_svg(page, title, summary, counted_in, about) for page in _pages(panels, panels_a_page)]


def residual_map(data: SessionData, settings: Mapping[str, str], about: str) -> bytes:
    """Return what `GET .../intrinsics/residuals.svg` answers."""
    groups = _chosen_groups(data, settings)
    title = f"Residuals over the image ({_estimated(settings)})"
    return residuals_svg([residual_field(group) for group in groups], title, about)


def projection_map(data: SessionData, settings: Mapping[str, str], about: str) -> bytes:
    """Return what `GET .../intrinsics/projection-uncertainty.svg` answers."""
    groups = _chosen_groups(data, settings)
    title = f"Projection uncertainty over the image ({_estimated(settings)})"
    return projection_svg([projection_field(group) for group in groups], title, about)


def _estimated(settings: Mapping[str, str]) -> str:
    """Return the estimator by the name that pages and reports give it."""
    return words(settings["estimator"])


def _chosen_groups(data: SessionData, settings: Mapping[str, str]) -> Sequence[FocusGroup]:
    """Return the focus groups to draw; raises NotFound, NothingUsable, or AnalysisError for too many of them."""
    wanted = settings.get("focus_group")
    if wanted is not None and wanted not in {image.focus_group for image in data.images}:
        raise NotFound(
            "None of the session's measured images is of that focus group.",
            "Name one that the session's intrinsics list (GET .../intrinsics).",
            code="focus_group_not_found",
        )
    session = with_print_uncertainty(data, estimate_session(data, settings["estimator"], weak=True))
    groups = [group for group in session.groups if wanted in (None, group.name)]
    if not groups:
        reasons = Counter(e.code for e in session.excluded.values())
        raise NothingUsable(
            f"No image of focus group {wanted!r} serves: {_listed(reasons)}.",
            "The session's intrinsics have the reasons (GET .../intrinsics).",
        )
    if len(groups) > MAX_ROWS:
        raise _too_many(len(groups), "focus groups", "focus_group")
    return groups


@dataclass(frozen=True, slots=True)
class _Source:
    """Whoever measured, and its rows."""

    rows: Sequence[PoseRow]
    steadiness: SessionSteadiness
    frame: str
    how: str


def _source(data: SessionData, settings: Mapping[str, str]) -> _Source:
    if settings["source"] == "measured_poses":
        read = measured_rows(data)
        return _Source(read.rows, read.steadiness, "instrument's frame", "another instrument")
    estimate = estimate_session(data, settings["estimator"])
    seen = image_rows(data, estimate)
    frame = "target frame" if data.camera_mount == "robot" else "camera frame"
    return _Source(seen.rows, seen.steadiness, frame, _estimated(settings))


def _chosen(rows: Sequence[PoseRow], pose_id: str | None) -> Sequence[PoseRow]:
    """Return the rows to draw: all, or one pose's; raises AnalysisError for none, too many, or nothing in them."""
    if pose_id is not None:
        rows = [row for row in rows if row.pose_id == pose_id]
        if not rows:
            raise TooFewMeasurements(
                f"Nothing is measured yet of pose {pose_id}.",
                "Upload images of it, or wait until they are measured.",
            )
    if len(rows) > MAX_ROWS:
        raise _too_many(len(rows), "poses", "pose_id")
    if not any(row.visits for row in rows):
        reasons = Counter(e.code for row in rows for e in row.excluded)
        raise NothingUsable(
            f"No image of {'this pose' if len(rows) == 1 else 'these poses'} counts: {_listed(reasons)}.",
            "Look at the measurements' failures and overlays; show the whole grid, sharp, evenly lit, and tilted.",
        )
    return rows


def _pages(shown: Sequence[Shown], at_most: int | None) -> list[Sequence[Shown]]:
    """Return what each page shows, about as much as each other one; all on one page where no number is given."""
    count = max(math.ceil(len(shown) / at_most), 1) if at_most is not None else 1
    return [shown[len(shown) * k // count : len(shown) * (k + 1) // count] for k in range(count)]


def _too_many(count: int, what: str, parameter: str) -> AnalysisError:
    return AnalysisError(
        "too_many_for_plot",
        f"The session has {count} {what}; one plot shows {MAX_ROWS}.",
        f"Name one of them with {parameter}=.",
    )


def _listed(reasons: Mapping[str, int]) -> str:
    return ", ".join(f"{code.replace('_', ' ')} ({count})" for code, count in sorted(reasons.items()))


def _scatter(row: PoseRow) -> PoseScatter:
    counted = row.visits
    positions = _stacked([visit.position_mm for visit in counted])
    figures = row.figures
    # Without an interval the value says nothing of the robot.
    known = figures is not None and figures.corrected_interval.position_mm is not None
    corrected = figures.corrected if figures is not None and known else None
    outlying = np.isin(np.arange(len(counted)), [o.index for o in figures.outliers] if figures else [])
    noise = [visit.scatter[:3, :3] for visit in counted if visit.scatter is not None]
    return PoseScatter(
        pose_id=row.pose_id,
        positions_mm=positions[~outlying],
        outliers_mm=positions[outlying],
        observed_mm2=np.cov(positions, rowvar=False) if len(positions) > 1 else None,
        noise_mm2=np.mean(noise, axis=0) if counted and len(noise) == len(counted) else None,
        rp_mm=figures.repeatability.position_mm if figures else None,
        interval_mm=figures.interval.position_mm if figures else None,
        floor_mm=figures.noise_floor.position_mm if figures else None,
        corrected_mm=corrected.position_mm if corrected is not None else None,
        verdict=figures.verdict if figures else "too_few_cycles",
        note="" if counted else f"no image counts: {_listed(Counter(e.code for e in row.excluded))}",
    )


def _stacked(positions: Sequence[Float[np.ndarray, "3"]]) -> Float[np.ndarray, "n 3"]:
    return np.array(positions, dtype=np.float64).reshape(-1, 3)
