"""Decisions on a data sheet from a session: no pose is forgotten, and no cycles count whose steadiness is unknown."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.trust.bowed_sessions import DEPARTURES, Departure, Setup, simulate
from core.errors import Advisory
from core.metrology import REPEATED, WITHOUT_DEGRADED, Decision, decide, repeatability_reading
from core.session import (
    CommandedPose,
    ExcludedMeasurement,
    SessionData,
    assess_acceptance,
    assess_repeatability,
    estimate_session,
)
from core.session.model import Datasheet
from core.session.repeatability import pose_rows
from core.session.repeatability.acceptance import UNDETERMINED, UNSCALED, LimitAcceptance
from core.session.repeatability.witness import Witness
from tests.support.simulation import session_cycles as made

LOOSE = Datasheet(repeatability_mm=1.0, accuracy_mm=5.0)


def decided(data: SessionData, limits: Datasheet = LOOSE) -> LimitAcceptance:
    data = replace(data, datasheet=limits)
    found = assess_acceptance(data, assess_repeatability(data)).repeatability
    assert found is not None
    return found


def commands(poses: int = 5) -> dict[str, CommandedPose]:
    """Commands of one orientation at corners of a cube."""
    places = 100.0 * np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 1, 1], [0, 0, 1]], dtype=float)
    return {
        f"P{i + 1}": CommandedPose(place.tolist(), 0.0, 0.0, 0.0) for i, place in enumerate(places[:poses])
    }


def at_commands(x: np.ndarray, commanded: dict[str, CommandedPose]) -> SessionData:
    """The cycles at the places that were commanded."""
    data = made.measured_session(x - 100.0 * np.arange(1, x.shape[1] + 1)[None, :, None])
    measured = tuple(
        replace(pose, position_mm=pose.position_mm + np.array(commanded[pose.pose_id].position_mm))
        for pose in data.measured
    )
    return replace(data, measured=measured)


def test_distances_that_are_off_by_one_factor_decide_nothing_of_accuracy() -> None:
    """A print of another pitch than stated is not the robot's fault."""
    commanded = commands()
    data = at_commands(made.gaussian(np.random.default_rng(5), 12, 5), commanded)
    data = replace(data, commanded=commanded, datasheet=Datasheet(repeatability_mm=1.0, accuracy_mm=1.0))
    scaled = replace(
        data, measured=tuple(replace(pose, position_mm=1.03 * pose.position_mm) for pose in data.measured)
    )
    for one, decision in ((data, Decision.PASS), (scaled, Decision.INCONCLUSIVE)):
        table = assess_repeatability(one)
        found = assess_acceptance(one, table)
        assert found.repeatability is not None
        assert found.repeatability.found.decision is Decision.PASS
        assert found.accuracy is not None
        assert found.accuracy.found.decision is decision
        named = "instrument_scale_mismatch" in {warning.code for warning in table.warnings}
        assert named == (decision is Decision.INCONCLUSIVE)


def test_poses_that_agree_with_the_other_camera_mount_decide_nothing_of_accuracy() -> None:
    """A mount that is stated wrongly is not the robot's fault either: such robots failed in spite of the warning."""
    commanded = commands(6)
    data = at_commands(made.gaussian(np.random.default_rng(5), 12, 6), commanded)
    commanded["P6"] = CommandedPose([5.0, 0.0, 100.0], 0.0, 0.0, 0.0)
    for limit, decision in ((20.0, Decision.PASS), (1.0, Decision.FAIL)):
        one = replace(data, commanded=commanded, datasheet=Datasheet(accuracy_mm=limit))
        table = assess_repeatability(one)
        contradicted = replace(table.accuracy, warnings=(Advisory("camera_mount_unlikely", "", ""),))
        for accuracy, expected in ((table.accuracy, decision), (contradicted, Decision.INCONCLUSIVE)):
            found = assess_acceptance(one, replace(table, accuracy=accuracy)).accuracy
            assert found is not None
            assert found.found.decision is expected
            assert ("mounted" in found.found.reason) == (accuracy is contradicted)


def test_cycles_without_numbers_decide_nothing() -> None:
    """Correlated cycles read too little of the scatter; without numbers nothing shows that they are correlated."""
    limits = Datasheet(repeatability_mm=0.085)  # the robot has .1
    outcomes: dict[bool, Counter[Decision]] = {True: Counter(), False: Counter()}
    for seed in range(6):
        x = made.correlated(np.random.default_rng(seed), 30, phi=0.9)
        for numbered in outcomes:
            found = decided(made.measured_session(x, numbered=numbered), limits)
            outcomes[numbered][found.found.decision] += 1
    assert outcomes[False] == {Decision.INCONCLUSIVE: 6}
    assert outcomes[True][Decision.PASS] == 0
    steady = made.gaussian(np.random.default_rng(1), 30)
    assert decided(made.measured_session(steady)).found.decision is Decision.PASS
    unnumbered = decided(made.measured_session(steady, numbered=False))
    assert "want of cycle numbers" in unnumbered.found.reason
    assert unnumbered.worst_mm is not None


def test_a_pose_whose_instrument_changed_is_as_unsteady_as_any(monkeypatch: Any) -> None:
    """Its verdict names the instrument; that its cycles move is not forgotten for that."""
    data = made.measured_session(made.own_drifts(np.random.default_rng(3), 30))
    rows = pose_rows._rows
    assert decided(data).found.decision is Decision.INCONCLUSIVE

    def changed(data: Any, visits: Any, excluded: Any, _unreliable: Any, witness: Any) -> Any:
        return rows(data, visits, excluded, frozenset(visits), witness)

    monkeypatch.setattr(pose_rows, "_rows", changed)
    found = assess_repeatability(data)
    assert {row.figures.verdict for row in found.poses if row.figures is not None} == {"instrument_limited"}
    assert decided(data).found.decision is Decision.INCONCLUSIVE


@pytest.mark.parametrize("limits", [LOOSE, Datasheet(repeatability_mm=0.2)])
def test_a_pose_that_was_commanded_and_not_measured_may_be_the_worst(limits: Datasheet) -> None:
    data = made.measured_session(made.gaussian(np.random.default_rng(4), 30))
    assert decided(data, limits).found.decision is Decision.PASS
    more_commanded = replace(data, commanded=commands(poses=6))
    found = decided(more_commanded, limits)
    assert found.found.decision is Decision.INCONCLUSIVE
    assert found.found.reason.startswith("1 of 6 poses")
    assert "without a cycle that counts" in found.found.reason


def test_accuracy_is_decided_of_every_pose_whose_position_was_commanded() -> None:
    pose_commands = commands()
    data = replace(
        at_commands(made.gaussian(np.random.default_rng(5), 30), pose_commands),
        commanded=pose_commands,
        datasheet=LOOSE,
    )
    assert assess_repeatability(data).accuracy.poses.keys() == pose_commands.keys()
    passed = assess_acceptance(data, assess_repeatability(data)).accuracy
    assert passed is not None
    assert passed.found.decision is Decision.PASS
    more = replace(data, commanded=commands(poses=6))
    left_open = assess_acceptance(more, assess_repeatability(more)).accuracy
    assert left_open is not None
    assert left_open.found.decision is Decision.INCONCLUSIVE
    assert "without a cycle that counts" in left_open.found.reason
    # One that was measured, of which no accuracy is known.
    found = assess_repeatability(data)
    fewer = replace(found.accuracy, poses={p: one for p, one in found.accuracy.poses.items() if p != "P3"})
    undetermined = assess_acceptance(data, replace(found, accuracy=fewer)).accuracy
    assert undetermined is not None
    assert undetermined.found.reason == f"1 of 5 poses is open: P3, {UNDETERMINED}"


def test_an_unstated_pitch_decides_nothing_of_accuracy() -> None:
    for departure, reason in ((DEPARTURES[0], UNSCALED), (Departure("known", stated=1e-9), None)):
        data, true = simulate(np.random.default_rng(5), Setup(), departure)
        places = {p: CommandedPose(place.tolist(), 0.0, 0.0, 0.0) for p, place in true.items()}
        data = replace(data, commanded=places, datasheet=Datasheet(accuracy_mm=1e4))
        found = assess_acceptance(data, assess_repeatability(data, estimate_session(data))).accuracy
        assert found is not None
        assert found.worst_mm is not None
        assert (found.found.decision is Decision.INCONCLUSIVE) == (reason is not None)
        if reason is not None:
            assert reason in found.found.reason


def test_an_instrument_of_unknown_noise_passes_a_robot_but_does_not_fail_it() -> None:
    data = made.measured_session(made.gaussian(np.random.default_rng(6), 30), instrument=False)
    assert decided(data).found.decision is Decision.PASS
    assert decided(data, Datasheet(repeatability_mm=0.01)).found.decision is Decision.INCONCLUSIVE
    known = made.measured_session(made.gaussian(np.random.default_rng(6), 30))
    assert decided(known, Datasheet(repeatability_mm=0.01)).found.decision is Decision.FAIL


def test_a_pose_that_draws_the_frames_to_itself_does_not_pass() -> None:
    """Of five poses one is far off; its residual is short, and the other poses' are small."""
    places = np.array([[400.0, 350.0, 300.0], [0, 0, 0], [100, 0, 20], [0, 100, 50], [80, 90, 10]])
    pose_commands = {
        f"P{i + 1}": CommandedPose(place.tolist(), 0.0, 0.0, 0.0) for i, place in enumerate(places)
    }
    best_fit = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        off = 0.02 * rng.standard_normal((5, 3))
        off[0] = 0.5 * off[0] / np.linalg.norm(off[0])
        data = replace(
            at_commands(off + 0.02 * rng.standard_normal((30, 5, 3)), pose_commands), commanded=pose_commands
        )
        data = replace(data, datasheet=Datasheet(accuracy_mm=0.4))  # the robot is .5 mm off
        found = assess_repeatability(data)
        best_fit += found.accuracy.poses["P1"].interval.position_mm[1] < 0.4
        decision = assess_acceptance(data, found).accuracy
        assert decision is not None
        assert decision.found.decision is not Decision.PASS
    assert best_fit >= 3  # which the intervals of poses of one kind would pass


def test_a_pose_of_another_kind_is_judged_by_its_own_cycles() -> None:
    """Correlated cycles read too little of the scatter; four white poses hide that they are correlated."""
    limits = Datasheet(repeatability_mm=0.1)
    shared = by_itself = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        x = 0.2 * made.gaussian(rng, 12)
        x[:, 0] = made.correlated(rng, 12, 1)[:, 0]
        data = replace(made.measured_session(x), datasheet=limits)
        found = assess_repeatability(data)
        figures = [row.figures for row in found.poses if row.figures is not None]
        shared += decide(0.1, [repeatability_reading(one) for one in figures]).decision is Decision.PASS
        decision = assess_acceptance(data, found).repeatability
        assert decision is not None
        by_itself += decision.found.decision is Decision.PASS
    assert shared >= 3
    assert by_itself <= shared // 2


def test_visits_of_one_cycle_do_not_count_as_cycles() -> None:
    data = made.measured_session(made.gaussian(np.random.default_rng(7), 30))
    thrice = tuple(
        replace(pose, cycle=(pose.cycle + 2) // 3) for pose in data.measured if pose.cycle is not None
    )
    found = decided(replace(data, measured=thrice))
    assert found.found.decision is Decision.INCONCLUSIVE
    assert found.found.reason == f"5 of 5 poses are open: P1, P2, P3, P4, P5, {REPEATED}"


def test_cycles_of_degraded_images_must_not_be_what_breaks_the_limit() -> None:
    data = replace(made.measured_session(made.gaussian(np.random.default_rng(8), 30)), datasheet=LOOSE)
    found = assess_repeatability(data)
    first = found.poses[0]
    assert first.figures is not None
    for with_all, decision in ((0.5, Decision.PASS), (1.5, Decision.INCONCLUSIVE)):
        figures = replace(first.figures.repeatability, position_mm=with_all)
        poses = (replace(first, including_degraded=figures), *found.poses[1:])
        judged = assess_acceptance(data, replace(found, poses=poses)).repeatability
        assert judged is not None
        assert judged.found.decision is decision
        assert (WITHOUT_DEGRADED in judged.found.reason) == (decision is Decision.INCONCLUSIVE)


def test_a_robot_that_passes_is_advised_what_the_decision_does_not_cover() -> None:
    pose_commands = commands()
    data = replace(
        at_commands(made.gaussian(np.random.default_rng(9), 30), pose_commands),
        commanded=pose_commands,
        datasheet=LOOSE,
    )
    found = assess_repeatability(data)
    plain = assess_acceptance(data, found)
    assert plain.repeatability is not None
    assert plain.accuracy is not None
    assert plain.repeatability.found.reason == "the intervals of all poses lie within the limit"
    assert plain.accuracy.found.reason.endswith("; what base and tool are off is not tested")
    not_counted = ExcludedMeasurement("m", "excluded_by_user", "Someone was in front of it.")
    poses = (replace(found.poses[0], excluded=(not_counted,)), *found.poses[1:])
    fewer = assess_acceptance(data, replace(found, poses=poses)).repeatability
    assert fewer is not None
    assert fewer.found.reason.endswith("; 1 measurement does not count")
    watched = assess_repeatability(data, witness=Witness("P1", subtract=True))
    assert watched.witness is not None
    subtracted = assess_acceptance(data, watched).repeatability
    assert subtracted is not None
    assert subtracted.found.reason.endswith("; the witness's motion was subtracted")


def test_what_the_tie_leaves_open_takes_poses_and_the_interval_that_decides_is_stated() -> None:
    rng = np.random.default_rng(1)
    pose_commands = commands()
    off = 0.3 * rng.standard_normal((1, 5, 3))
    for cycles in (12, 40):
        data = at_commands(0.01 * rng.standard_normal((cycles, 5, 3)) + off, pose_commands)
        data = replace(data, commanded=pose_commands, datasheet=Datasheet(accuracy_mm=0.7))
        found = assess_repeatability(data)
        one = assess_acceptance(data, found).accuracy
        assert one is not None
        assert one.found.decision is Decision.INCONCLUSIVE
        assert one.found.cycles_needed is None
        assert one.found.poses_needed is None or one.found.poses_needed > 5
        assert "more poses narrow" in one.found.reason
        assert one.pose_id is not None
        accuracy = found.accuracy.poses[one.pose_id]
        assert accuracy.held_out_interval is not None
        assert one.found.interval is not None
        assert one.found.interval[1] == accuracy.held_out_interval[1] > 0.7
