"""Views that were taken once and belong to no cycle: they determine the lens, and are no poses of a test."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from core.metrology import Decision
from core.session import (
    CommandedPose,
    SessionAcceptance,
    SessionData,
    assess_acceptance,
    assess_repeatability,
)
from core.session.model import Datasheet
from tests.support.simulation import session_cycles as made

PLACES = 100.0 * np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 1, 1], [0.5, 0.2, 0.7]])
VIEW = "T1"


def planned_session() -> SessionData:
    """Five poses of thirty cycles, and one view."""
    x = made.gaussian(np.random.default_rng(4), 30, 6)
    data = made.measured_session(x - 100.0 * np.arange(1, 7)[None, :, None])
    names = {f"P{i + 1}": f"P{i + 1}" if i < 5 else VIEW for i in range(6)}
    places = dict(zip(names.values(), PLACES, strict=True))
    measured = tuple(
        replace(
            pose,
            pose_id=names[pose.pose_id],
            cycle=pose.cycle if names[pose.pose_id] != VIEW else None,
            position_mm=pose.position_mm + places[names[pose.pose_id]],
        )
        for pose in data.measured
        if names[pose.pose_id] != VIEW or pose.cycle == 1
    )
    commanded = {name: CommandedPose(place.tolist(), 0.0, 0.0, 0.0) for name, place in places.items()}
    return replace(data, measured=measured, commanded=commanded, datasheet=Datasheet(1.0, 5.0))


def decided(data: SessionData) -> SessionAcceptance:
    return assess_acceptance(data, assess_repeatability(data))


def test_a_robot_passes_without_views_that_belong_to_no_cycle_and_the_reason_names_them() -> None:
    found = decided(planned_session())
    for one in (found.repeatability, found.accuracy):
        assert one is not None
        assert one.found.decision is Decision.PASS
        assert "T1, seen once and in no cycle, is not tested" in one.found.reason


def test_a_pose_that_lost_its_other_cycles_leaves_the_decision_open() -> None:
    data = planned_session()
    view = data.measured[-1]
    assert view.pose_id == VIEW
    again = replace(view, measurement_id="again", position_mm=view.position_mm + 0.01)
    for instead in ((replace(view, cycle=1),), (view, again)):
        found = decided(replace(data, measured=(*data.measured[:-1], *instead))).repeatability
        assert found is not None
        assert found.found.decision is Decision.INCONCLUSIVE
        assert found.found.reason.startswith("1 of 6 poses is open: T1")


def test_single_views_alone_are_open_poses() -> None:
    data = planned_session()
    found = decided(replace(data, measured=data.measured[-1:], commanded={})).repeatability
    assert found is not None
    assert found.found.reason == "1 of 1 poses is open: T1, of fewer than ten cycles"
