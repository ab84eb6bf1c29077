"""What the plot of drift states is what table and report state."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np

from app.analyses.documents.plots.pose_drift import pose_drift
from core.session import MeasuredPose, PoseRow, SessionData, drift_of


def test_errors_of_block_means_have_the_resolution_of_the_readings_in_them() -> None:
    data = cast(SessionData, SimpleNamespace(time_source="received_at"))
    rng = np.random.default_rng(4)
    exact = rng.normal(0.0, 0.02, (30, 3))  # scatter far below the step of .1 mm, so that many are equal
    exact[::6] += 0.06
    visits = tuple(
        MeasuredPose(f"mpo_{k}", "P1", k + 1, None, np.round(position, 1), None, None, None)
        for k, position in enumerate(exact)
    )
    row = PoseRow("P1", visits, (), None)
    drifting, drawn = drift_of(row), pose_drift(row, data)
    assert drifting is not None
    assert drawn is not None
    for block, shown in zip(drifting[1].blocks, drawn.blocks, strict=True):
        assert np.array_equal(shown.position.mean, block.mean_position_mm)
        assert np.array_equal(shown.position.standard_error, block.standard_error_mm)
        positions = np.array(
            [visit.position_mm for visit in visits[block.first_cycle - 1 : block.last_cycle]]
        )
        scatter = positions.std(axis=0, ddof=1) / np.sqrt(len(positions))
        assert np.all(shown.position.standard_error > 1.2 * scatter)
