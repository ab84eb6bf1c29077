"""Poses of one command under several ids tie the frames once, and each has its own accuracy."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
import pytest

from benchmarks.trust.accuracy import LAYOUTS, Layout, simulate_visits
from core.metrology import PoseAccuracy
from core.session import (
    CommandedPose,
    Datasheet,
    MeasuredPose,
    SessionData,
    assess_acceptance,
    assess_repeatability,
)
from core.session.commanded_poses import Accuracy, assess_accuracy, command_key, distinct_commands
from core.session.commanded_poses.equal_commands import MAX_JOINTS_APART_DEG, stations_of

CUBE, ANY_FIVE, _, ANY_TEN, POSITIONS, _ = LAYOUTS
IDS = "abc"
Visits = dict[str, list[MeasuredPose]]


@pytest.fixture
def without_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do without the intervals of lengths, most of the time, where those of the axes serve."""
    monkeypatch.setattr("core.metrology.accuracy.deviations.length_limits", lambda parts: (0.0, 0.0))


def under_three_ids(data: SessionData, visits: Visits) -> tuple[SessionData, Visits]:
    """Return the session with the visits of each pose divided among three ids of its command."""
    commanded, divided = {}, {}
    for name, of_pose in visits.items():
        for k, letter in enumerate(IDS):
            commanded[name + letter] = dataclasses.replace(data.commanded[name], approach=letter)
            divided[name + letter] = [
                dataclasses.replace(visit, pose_id=name + letter, cycle=1 + i)
                for i, visit in enumerate(of_pose[k::3])
            ]
    return dataclasses.replace(data, commanded=commanded), divided


def simulated(
    layout: Layout, seed: int, *, oriented: bool = True, cycles: int = 12
) -> tuple[SessionData, Visits, np.ndarray]:
    """Draw a robot's visits."""
    rng = np.random.default_rng([9283, seed])
    data, visits, off, _ = simulate_visits(rng, dataclasses.replace(layout, cycles=cycles))
    if not oriented:
        visits = {p: [dataclasses.replace(v, rotation=None) for v in vs] for p, vs in visits.items()}
    return data, visits, off


def vector(one: PoseAccuracy) -> np.ndarray:
    return np.array([one.figures.x_mm, one.figures.y_mm, one.figures.z_mm], dtype=np.float64)


@pytest.mark.usefixtures("without_intervals")
@pytest.mark.parametrize(
    ("layout", "oriented"),
    [(CUBE, True), (CUBE, False), (ANY_TEN, True), (ANY_TEN, False), (POSITIONS, True)],
)
def test_three_ids_tie_the_frames_as_one_does(layout: Layout, *, oriented: bool) -> None:
    data, visits, _ = simulated(layout, 1, oriented=oriented)
    one, three = assess_accuracy(data, visits).poses, assess_accuracy(*under_three_ids(data, visits)).poses
    assert set(three) == {name + letter for name in one for letter in IDS}
    for name, of_one in one.items():
        twins = [three[name + letter] for letter in IDS]
        for twin in twins:
            assert twin.degrees_of_freedom == pytest.approx(of_one.degrees_of_freedom, rel=1e-9)
            # Of four visits an id's own mean scatters by .03 mm / √4, and thrice that is rare along an axis.
            np.testing.assert_allclose(vector(twin), vector(of_one), atol=4.0 * 0.015)
            assert (twin.rotation is None) == (of_one.rotation is None)
        # Ids have as many visits: what they are off by has the mean of their command.
        np.testing.assert_allclose(
            np.mean([vector(twin) for twin in twins], axis=0), vector(of_one), atol=1e-3
        )
        held = [twin.held_out.x_mm for twin in twins]
        assert np.mean(np.array(held, dtype=np.float64)) == pytest.approx(of_one.held_out.x_mm, abs=1e-3)


def test_an_id_that_stops_elsewhere_differs_by_what_was_measured() -> None:
    data, visits = under_three_ids(*simulated(CUBE, 2)[:2])
    before = assess_accuracy(data, visits).poses
    shift = np.array([0.0, 0.06, 0.0])
    visits["P2b"] = [dataclasses.replace(v, position_mm=v.position_mm + shift) for v in visits["P2b"]]
    after = assess_accuracy(data, visits).poses
    apart = [vector(found["P2b"]) - vector(found["P2a"]) for found in (before, after)]
    assert np.linalg.norm(apart[1] - apart[0]) == pytest.approx(0.06, abs=1e-4)
    interval, figure = after["P2b"].interval.position_mm, after["P2b"].figures.position_mm
    assert interval is not None
    assert figure is not None
    assert interval[0] <= figure <= interval[1]


@cache
def covered(layout: Layout, seed: int) -> tuple[float, float]:
    """Return the share of axes whose 95 % interval holds the truth, of a session with one id and with three."""
    data, visits, off = simulated(layout, seed)

    def share(found: Accuracy) -> float:
        held = []
        for name, one in found.poses.items():
            true = off[int(name.rstrip(IDS)[1:]) - 1]
            intervals = (one.interval.x_mm, one.interval.y_mm, one.interval.z_mm)
            held += [i is not None and i[0] <= t <= i[1] for i, t in zip(intervals, true, strict=True)]
        return float(np.mean(held))

    return share(assess_accuracy(data, visits)), share(assess_accuracy(*under_three_ids(data, visits)))


@pytest.mark.usefixtures("without_intervals")
@pytest.mark.parametrize("sessions", [16, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.parametrize("layout", [CUBE, ANY_FIVE])
def test_intervals_of_three_ids_hold_the_truth_as_often_as_those_of_one(
    layout: Layout, sessions: int
) -> None:
    one, three = np.mean([covered(layout, seed) for seed in range(sessions)], axis=0)
    print(f"one id {one:.3f}, three ids {three:.3f}")
    # The axes of a session share a tie: at most, all hold or none does, so that sessions are the sample.
    error = math.sqrt(0.95 * 0.05 / sessions)
    assert 0.95 - 3.0 * error < three
    assert abs(three - one) < 2.0 * error, "the same robots and readings"
    assert three < 1.0 or sessions < 50


def test_a_wrong_id_is_rejected_without_its_twins() -> None:
    data, visits = under_three_ids(*simulated(ANY_TEN, 3)[:2])
    right = assess_accuracy(data, visits).poses
    visits["P4b"] = [dataclasses.replace(v, pose_id="P4b") for v in visits["P7c"]]
    found = assess_accuracy(data, visits)
    (warning,) = [one for one in found.warnings if one.code == "poses_excluded"]
    assert "P4b." in warning.detail
    assert "P4a" not in warning.detail
    for name in ("P4a", "P4c", "P7b"):
        np.testing.assert_allclose(vector(found.poses[name]), vector(right[name]), atol=0.03)


def test_a_rejected_command_names_all_its_ids() -> None:
    data, visits = under_three_ids(*simulated(ANY_TEN, 4)[:2])
    commanded = dict(data.commanded)
    for letter in IDS:
        command = commanded["P4" + letter]
        assert command.position_mm is not None
        x, y, z = command.position_mm
        commanded["P4" + letter] = dataclasses.replace(command, position_mm=(x + 40.0, y, z))
    found = assess_accuracy(dataclasses.replace(data, commanded=commanded), visits)
    (warning,) = [one for one in found.warnings if one.code == "poses_excluded"]
    assert "P4a, P4b, P4c" in warning.detail
    assert {"P4a", "P4b", "P4c"} <= set(found.poses)


def test_poses_needed_counts_commands() -> None:
    data, visits, _ = simulated(CUBE, 5, cycles=36)

    def needed(session: SessionData, of_pose: Visits) -> int | None:
        measured = tuple(visit for name in of_pose for visit in of_pose[name])
        stated = dataclasses.replace(session, measured=measured, datasheet=Datasheet(None, 1.2))
        decided = assess_acceptance(stated, assess_repeatability(stated)).accuracy
        assert decided is not None
        return decided.found.poses_needed

    of_one, of_three = needed(data, visits), needed(*under_three_ids(data, visits))
    assert of_one is not None
    assert of_three is not None
    # The worst of three ids is a little more than one pose's.
    assert abs(of_three - of_one) <= 1


def test_what_is_one_command() -> None:
    place = (100.0, 200.0, 300.0)
    half = CommandedPose(place, 180.0, 0.0, 30.0)
    assert command_key(half) == command_key(CommandedPose(place, -180.0, 0.0, 30.0, approach="left"))
    assert command_key(half) != command_key(CommandedPose(place, 180.0, 0.0, 30.1))
    assert command_key(half) != command_key(CommandedPose(place))
    assert command_key(CommandedPose()) is None
    assert distinct_commands({"P1": half, "P2": half, "P3": CommandedPose(), "P4": CommandedPose()}) == 3


def test_another_configuration_or_place_is_a_station_of_its_own() -> None:
    def visit(name: str, x: float) -> list[MeasuredPose]:
        return [MeasuredPose(name, name, 1, None, np.array([x, 0.0, 0.0]), None, None, None)]

    def stations(of_b: float, joint_deg: float) -> list[tuple[str, ...]]:
        angles = {"a": 0.0, "b": joint_deg, "far": 90.0}
        commands = {p: CommandedPose((0.0, 0.0, 0.0), joint_angles_deg=(q, 10.0)) for p, q in angles.items()}
        visits = {"a": visit("a", 0.0), "b": visit("b", of_b), "far": visit("far", 300.0)}
        return stations_of({"a": 1, "b": 1, "far": 2}, commands, visits)

    assert stations(0.1, 0.0) == [("a", "b"), ("far",)]
    assert stations(0.1, 0.9 * MAX_JOINTS_APART_DEG) == [("a", "b"), ("far",)]
    assert stations(0.1, 1.1 * MAX_JOINTS_APART_DEG) == [("a",), ("b",), ("far",)]
    assert stations(250.0, 0.0) == [("a",), ("b",), ("far",)]
