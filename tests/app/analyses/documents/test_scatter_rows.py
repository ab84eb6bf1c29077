"""What the plot of the scatter shows of which poses."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from app.analyses.documents.plots.drawing import scatter_plot
from core.session import SessionData
from tests.support.simulation import session_cycles as made

CYCLES = made.gaussian(np.random.default_rng(3), 12)


def rows(data: SessionData, **chosen: str) -> list[str]:
    """The lines of the drawing's description, one for each pose."""
    drawn = ElementTree.fromstring(scatter_plot(data, {"source": "measured_poses", **chosen}, ""))
    return str(drawn.findtext("{http://www.w3.org/2000/svg}desc")).splitlines()


def test_poses_of_one_cycle_are_drawn_where_there_is_no_other_or_one_is_asked_for() -> None:
    data = made.measured_session(CYCLES)
    once = tuple(one for one in data.measured if one.cycle == 1)
    mixed = replace(
        data, measured=tuple(one for one in data.measured if one.pose_id < "P3" or one.cycle == 1)
    )
    assert [line.partition(":")[0] for line in rows(mixed)] == ["P1", "P2"]
    assert [line.partition(":")[0] for line in rows(mixed, pose_id="P4")] == ["P4"]
    assert len(rows(replace(data, measured=once))) == 5


def test_a_corrected_figure_is_shown_where_it_is_determined() -> None:
    data = made.measured_session(CYCLES)
    assert all("corrected " in line for line in rows(data))
    noise = 0.02**2 * np.eye(
        6
    )  # of three quarters of the robot's scatter: the corrected RP_l has no interval
    coarse = tuple(replace(one, covariance=noise, scatter=noise) for one in data.measured)
    assert not any("corrected " in line for line in rows(replace(data, measured=coarse)))
