"""Readings that do not change say nothing of the robot, whatever the last digit of their numbers is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.metrology import Decision, Verdict
from core.session import (
    CommandedPose,
    MeasuredPose,
    SessionData,
    SessionRepeatability,
    assess_acceptance,
    assess_repeatability,
    drift_of,
)
from core.session.model import Datasheet
from core.session.repeatability.witness import Witness
from tests.support.simulation import session_cycles as made

PLACES = 200.0 * np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 1, 1]]) + [
    500.013,
    -100.0,
    600.007,
]


def session(frozen: int, poses: int, cycles: int = 30, *, turned: bool = False) -> SessionData:
    """The first poses read one value, which no float holds exactly."""
    rng = np.random.default_rng(4)
    measured = []
    for cycle in range(1, cycles + 1):
        for place, at in enumerate(PLACES[:poses]):
            off = np.zeros(3) if place < frozen else rng.normal(0.0, 0.02, 3)
            rotation = np.eye(3) if turned else None
            name = f"P{place + 1}"
            measured.append(
                MeasuredPose(f"m{name}{cycle}", name, cycle, None, at + off, rotation, made.NOISE, made.NOISE)
            )
    commanded = {
        f"P{place + 1}": CommandedPose(at.tolist(), 0.0, 0.0, 0.0) for place, at in enumerate(PLACES[:poses])
    }
    return replace(made.measured_session(np.zeros((2, 1, 3))), measured=tuple(measured), commanded=commanded)


def by_pose(found: SessionRepeatability) -> dict[str, object]:
    return {row.pose_id: row.figures.interval.position_mm for row in found.poses if row.figures is not None}


@pytest.mark.parametrize(("frozen", "poses", "cycles"), [(5, 5, 30), (2, 3, 30), (1, 1, 11), (2, 2, 5)])
def test_poses_that_do_not_change_are_named_and_others_keep_their_figures(
    frozen: int, poses: int, cycles: int
) -> None:
    found = assess_repeatability(session(frozen, poses, cycles, turned=True))
    for row in found.poses:
        assert row.figures is not None
        still = int(row.pose_id[1:]) <= frozen
        assert (row.figures.repeatability.position_mm == 0.0) is still
        assert (row.figures.interval.position_mm is None) is still
        assert (row.figures.corrected.position_mm is None) is still
        assert row.figures.verdict is not Verdict.ROBOT or not still
        assert not still or drift_of(row) is None
    (warning,) = [one for one in found.warnings if one.code == "no_scatter"]
    assert ("P1" in warning.detail, "P3" in warning.detail) == (True, poses == frozen == 5)
    assert "frozen" in warning.advice
    assert {one.code for one in found.warnings}.isdisjoint({"steadiness_not_tested", "not_steady"})
    assert np.isfinite(found.steadiness.process.tails).all()
    assert found.steadiness.pose_ids == tuple(f"P{i + 1}" for i in range(frozen, poses))
    for one in found.performance.distances:
        if int(one.from_pose_id[1:]) <= frozen:
            assert one.found.interval_mm is one.found.standard_uncertainty_mm is None


def test_the_sound_pose_has_the_figures_that_it_has_alone() -> None:
    whole = session(2, 3)
    alone = replace(whole, measured=tuple(one for one in whole.measured if one.pose_id == "P3"))
    assert by_pose(assess_repeatability(whole))["P3"] == by_pose(assess_repeatability(alone))["P3"]


def test_no_robot_passes_or_fails_by_readings_that_do_not_change() -> None:
    data = replace(session(2, 5), datasheet=Datasheet(repeatability_mm=1.0, accuracy_mm=5.0))
    found = assess_acceptance(data, assess_repeatability(data))
    for one in (found.repeatability, found.accuracy):
        assert one is not None
        assert one.found.decision is Decision.INCONCLUSIVE
        assert "P1, P2, whose readings do not change" in one.found.reason


def test_a_witness_that_does_not_change_did_not_move() -> None:
    found = assess_repeatability(session(1, 3), witness=Witness("P1", subtract=True))
    assert found.witness is not None
    assert not found.witness.moved
