"""The plot of a session's steadiness: what the test found, as plain values for `app.reports.steadiness`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from app.analyses.documents.plots.chance import length_limit, trend_limits
from app.reports.steadiness import SteadinessPanel
from core.errors import TooFewCycles, listed
from core.metrology import NOT_STEADY, Attribution, CycleGrid, Steadiness
from core.session import SessionSteadiness

_ATTRIBUTED = {
    Attribution.COMMON: "the poses move together",
    Attribution.POSE_BY_POSE: "poses move by themselves",
    Attribution.UNDETERMINED: "what moves is not determined",
}


def steadiness_panels(steadiness: SessionSteadiness, chosen: Sequence[str]) -> list[SteadinessPanel]:
    """Return the panel of the common motion, where there are several poses, and those of the poses chosen.

    Raises TooFewCycles where nothing was tested.
    """
    found, grid = steadiness.found, steadiness.found.grid
    if grid is None or found.p_values is None:
        raise TooFewCycles(
            "No pose has six visits with a cycle number each, so that the order of the cycles was not tested.",
            "Give every image or reading its cycle; 30 cycles of each pose are the standard.",
        )
    moves = found.p_values.overall <= NOT_STEADY
    panels = [_common(found, grid, moves)] if len(found.poses) > 1 else []
    split = {one.pose: one for one in found.two_points}
    for column, pose in enumerate(found.poses):
        pose_id = steadiness.pose_ids[pose.pose]
        if pose_id not in chosen:
            continue
        seen = grid.present[:, column]
        offsets, cycles = grid.deviations_mm[seen, column], grid.numbers[seen]
        moved = moves and pose.pose in found.moved
        # Visits that share a cycle are averaged in the grid, and then are not marked.
        second = np.zeros(len(cycles), dtype=bool)
        if pose.pose in split and len(split[pose.pose].second) == len(cycles):
            second = split[pose.pose].second
        note = f"p {pose.p_value:.2g}"
        rows = np.flatnonzero(seen).astype(np.float64)
        limits = trend_limits(offsets, rows)
        if pose.pose in split:
            note += f"   ·   two points, {_length(split[pose.pose].distance_mm)}"
        panels.append(
            SteadinessPanel(
                pose_id,
                note,
                _moved(pose.change_mm, _trend_uncertainty(offsets, rows), limits),
                pose.pose not in found.moved,
                cycles,
                offsets,
                _line(cycles, offsets) if moved else None,
                pose.change_cycle if moved else None,
                second,
                float(limits.max()),
            )
        )
    return panels


def steadiness_summary(steadiness: SessionSteadiness) -> str:
    """Return one line on what the test found."""
    found = steadiness.found
    if found.p_values is None:
        return "not tested"
    p = found.p_values
    verdict = "not steady" if found.steady is False else "nothing speaks against steady cycles"
    signs = [_ATTRIBUTED[found.attribution]] if found.attribution is not None else []
    if found.two_points and not signs:  # a step of all cycles makes two clusters of its own
        named = listed(steadiness.pose_ids[one.pose] for one in found.two_points)
        signs.append(f"two stopping points at {named}")
    why = f": {', and '.join(signs)}" if signs else ""
    return (
        f"{verdict}{why}   ·   p {p.overall:.2g} (trend {p.trend:.2g}, change point {p.change_point:.2g}, "
        f"autocorrelation {p.autocorrelation:.2g})"
    )


def _common(found: Steadiness, grid: CycleGrid, moves: bool) -> SteadinessPanel:
    steady = not (moves and found.attribution is not Attribution.POSE_BY_POSE)
    limits = trend_limits(grid.common_mm, np.arange(len(grid.common_mm), dtype=np.float64))
    step = moved = ""
    if found.trend is not None:
        moved = _moved(found.trend.change_mm, found.trend.standard_uncertainty_mm, limits)
    if found.change_point is not None:
        length = _uncertain_length(found.change_point.step_mm, found.change_point.standard_uncertainty_mm)
        step = f"largest step {length} at {found.change_point.cycle}"
    return SteadinessPanel(
        "common to all poses",
        step,
        moved,
        steady,
        grid.numbers,
        grid.common_mm,
        None if steady else _line(grid.numbers, grid.common_mm),
        None if steady or found.change_point is None else found.change_point.cycle,
        np.zeros(len(grid.numbers), dtype=bool),
        float(limits.max()),
    )


def _moved(
    change_mm: Float[np.ndarray, "3"],
    uncertainty_mm: Float[np.ndarray, "3"],
    limits_mm: Float[np.ndarray, "3"],
) -> str:
    limit = length_limit(limits_mm)
    largest = max(float(np.linalg.norm(change_mm)), limit)
    return (
        f"moved {_uncertain_length(change_mm, uncertainty_mm, largest)} by its trend "
        f"(chance alone: up to {_length(limit, largest)})"
    )


def _trend_uncertainty(
    offsets_mm: Float[np.ndarray, "n 3"], at: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "3"]:
    """Return the standard uncertainty of a straight line's change, by what scatters about the line; three or more."""
    about = at - at.mean()
    square, freedom = float(about @ about), len(at) - 2
    if square == 0.0 or freedom < 1:
        return np.zeros(3)
    left = offsets_mm - offsets_mm.mean(axis=0) - np.outer(about, about @ offsets_mm / square)
    return np.asarray(np.sqrt(np.sum(left**2, axis=0) / freedom / square) * float(np.ptp(at)))


def _line(cycles: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Return the straight line through the offsets at the first and the last cycle."""
    t = cycles - cycles.mean()
    slope = t @ offsets / max(float(t @ t), 1e-12)
    return np.asarray(offsets.mean(axis=0) + np.outer(t[[0, -1]], slope))


def _unit(largest_mm: float) -> tuple[str, float]:
    """Return the unit of lengths in one sentence by the largest of them, and what is in it of one mm."""
    return ("mm", 1.0) if largest_mm >= 0.1 else ("µm", 1e3)


def _length(value_mm: float, largest_mm: float | None = None) -> str:
    unit, factor = _unit(value_mm if largest_mm is None else largest_mm)
    return f"{value_mm * factor:.{3 if unit == 'mm' else 2}g} {unit}"


def _uncertain_length(
    vector_mm: Float[np.ndarray, "3"],
    uncertainty_mm: Float[np.ndarray, "3"],
    largest_mm: float | None = None,
) -> str:
    """Return a length with its standard uncertainty, that along the vector."""
    length = float(np.linalg.norm(vector_mm))
    along = float(np.linalg.norm(vector_mm * uncertainty_mm)) / length if length > 0.0 else 0.0
    unit, factor = _unit(length if largest_mm is None else largest_mm)
    decimals = 1 if along <= 0.0 else min(6, max(0, 1 - math.floor(math.log10(along * factor))))
    return f"{length * factor:.{decimals}f} ± {along * factor:.{decimals}f} {unit}"
