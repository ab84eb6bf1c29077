"""One pose's course over its cycles and over time, as plain values for `app.reports.drift`."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from app.analyses.documents.plots.chance import block_limits, length_limit
from app.analyses.documents.repeatability import visit_hours
from app.reports.drift import Block, BlockMean, PoseDrift
from core.geometry import rotation_mean, rotation_vectors
from core.session import PoseRow, SessionData, drift_of

CAPTURED = "captured_at"
"""Only these times say when a pose was visited; images may arrive days later."""


def pose_drift(row: PoseRow, data: SessionData) -> PoseDrift | None:
    """Return a pose's cycles and blocks; None where fewer than two visits have a cycle number."""
    visits = [visit for visit in row.visits if visit.cycle is not None]
    if len(visits) < 2:
        return None
    positions = np.array([visit.position_mm for visit in visits], dtype=np.float64)
    cycles = np.array([visit.cycle for visit in visits])
    hours = visit_hours(visits, data) if data.time_source == CAPTURED else None
    drifting = drift_of(row)
    if drifting is None:
        return PoseDrift(row.pose_id, cycles, positions, (), hours=hours)
    found = drifting[1].blocks
    bounds = [(block.first_cycle - 1, block.last_cycle) for block in found]
    places = [
        BlockMean(block.mean_position_mm, block.standard_error_mm, limit)
        for block, limit in zip(found, block_limits(positions, bounds), strict=True)
    ]
    rotations = np.array([visit.rotation for visit in visits if visit.rotation is not None])
    turns: Float[np.ndarray, "n 3"] | None = None
    turned: list[BlockMean | None] = [None] * len(found)
    if len(rotations) == len(visits):
        turns = np.degrees(rotation_vectors(rotations, rotation_mean(rotations[slice(*bounds[0])])))
        turned = [*_mean_turns(turns, bounds)]
    blocks = tuple(
        Block(int(cycles[start]), int(cycles[end - 1]), place, block.repeatability_mm, turn)
        for (start, end), place, block, turn in zip(bounds, places, found, turned, strict=True)
    )
    last_turn = turned[-1]
    return PoseDrift(
        row.pose_id,
        cycles,
        positions,
        blocks,
        turns,
        hours,
        length_limit(places[-1].by_chance),
        0.0 if last_turn is None else length_limit(last_turn.by_chance),
    )


def _mean_turns(turns: Float[np.ndarray, "n 3"], bounds: list[tuple[int, int]]) -> list[BlockMean]:
    limits = block_limits(turns, bounds)
    means = []
    for (start, end), limit in zip(bounds, limits, strict=True):
        part = turns[start:end]
        error = part.std(axis=0, ddof=1) / np.sqrt(len(part))
        means.append(BlockMean(part.mean(axis=0), error, limit))
    return means
