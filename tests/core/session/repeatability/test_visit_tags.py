"""Tags of visits that cannot be: another pose's visit, several focus groups, several visits of one cycle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.metrology import Decision, Verdict
from core.session import (
    ImageObservation,
    MeasuredPose,
    SessionData,
    SessionRepeatability,
    assess_acceptance,
    assess_repeatability,
)
from core.session.model import Datasheet
from core.session.repeatability.visit_tags import visit_tags
from core.targets import TargetSpec
from tests.support.simulation import session_cycles as made

LOOSE = Datasheet(repeatability_mm=1.0, accuracy_mm=5.0)


def codes(found: SessionRepeatability) -> set[str]:
    return {warning.code for warning in found.warnings}


def verdicts(found: SessionRepeatability) -> list[Verdict]:
    return [row.figures.verdict for row in found.poses if row.figures is not None]


def decision(data: SessionData, found: SessionRepeatability) -> Decision:
    of_limit = assess_acceptance(replace(data, datasheet=LOOSE), found).repeatability
    assert of_limit is not None
    return of_limit.found.decision


def steady(seed: int, cycles: int = 30) -> SessionData:
    return made.measured_session(made.gaussian(np.random.default_rng(seed), cycles))


def exchanged(data: SessionData, cycle: int) -> SessionData:
    """The session with the visits of P1 and P2 exchanged in one cycle."""
    other = {"P1": "P2", "P2": "P1"}
    places = {(one.pose_id, one.cycle): one.position_mm for one in data.measured}
    measured = (
        replace(one, position_mm=places[other[one.pose_id], cycle])
        if one.cycle == cycle and one.pose_id in other
        else one
        for one in data.measured
    )
    return replace(data, measured=tuple(measured))


@pytest.mark.parametrize("cycles", [3, 5, 30])
def test_an_exchange_of_two_poses_is_named_and_no_robots(cycles: int) -> None:
    data = exchanged(steady(1, cycles), 2)
    found = assess_repeatability(data)
    assert [(one.visit.pose_id, one.visit.cycle, one.likely_pose_id) for one in found.tags.mistaken] == [
        ("P1", 2, "P2"),
        ("P2", 2, "P1"),
    ]
    assert "visit_of_another_pose" in codes(found)
    assert "outliers" not in codes(found)  # named once, by what they are
    assert Verdict.ROBOT not in verdicts(found)[:2]
    assert decision(data, found) is Decision.INCONCLUSIVE
    first = found.poses[0].figures
    assert first is not None
    assert first.n == cycles  # nothing is removed
    assert first.repeatability.position_mm is not None
    assert first.repeatability.position_mm > 50.0
    if cycles == 30:
        assert verdicts(found)[2:] == [Verdict.ROBOT] * 3


def test_of_two_visits_one_is_named_where_the_other_is_at_no_pose() -> None:
    data = steady(2, 2)
    strayed = replace(data.measured[0], position_mm=data.measured[2].position_mm)
    found = assess_repeatability(replace(data, measured=(strayed, *data.measured[1:])))
    assert [(one.visit.measurement_id, one.likely_pose_id) for one in found.tags.mistaken] == [("m0-0", "P2")]
    assert not assess_repeatability(
        exchanged(data, 1)
    ).tags.mistaken  # each of the visits is at one of the two


@pytest.mark.parametrize("apart_mm", [0.05, 0.3, 1.0])
def test_poses_close_together_are_no_other_poses(apart_mm: float) -> None:
    """The robot scatters by .1 mm (RP), with heavy tails."""
    for seed in range(20):
        data = made.measured_session(made.student(np.random.default_rng(seed), 30))
        visits: dict[str, list[MeasuredPose]] = {}
        for one in data.measured:
            near = one.position_mm - (100.0 - apart_mm) * int(one.pose_id[1:])
            visits.setdefault(one.pose_id, []).append(replace(one, position_mm=near))
        assert not visit_tags(visits).mistaken


def test_cycles_of_two_focus_groups_are_no_robots() -> None:
    """The second group displaces every other cycle by .3 mm, as the error of a lens does."""
    data = replace(steady(3), targets=(TargetSpec("chessboard", 9, 6, 25.0),), target_ids=("T",))

    def seen(one: MeasuredPose, group: str) -> MeasuredPose:
        image = ImageObservation(
            one.measurement_id, one.pose_id, one.cycle, one.measurement_id, 0, group, None, 9, 9
        )
        return replace(one, image=image)

    def in_groups(poses: tuple[str, ...]) -> SessionData:
        measured = []
        for one in data.measured:
            second = one.pose_id in poses and (one.cycle or 0) % 2 == 0
            off = 0.3 if second else 0.0
            measured.append(
                replace(
                    seen(one, "b" if second else "a"), position_mm=one.position_mm + np.array([off, 0.0, 0.0])
                )
            )
        return replace(data, measured=tuple(measured))

    mixed = in_groups(("P2", "P4"))
    found = assess_repeatability(mixed)
    assert dict(found.tags.mixed) == {"P2": ("a", "b"), "P4": ("a", "b")}
    assert "focus_groups_mixed" in codes(found)
    assert not {"not_steady", "two_stopping_points"} & codes(found)  # nothing moved
    assert [verdict is Verdict.ROBOT for verdict in verdicts(found)] == [True, False, True, False, True]
    assert found.poses[1].figures is not None
    assert found.poses[1].figures.corrected_interval.position_mm is None
    assert decision(mixed, found) is Decision.INCONCLUSIVE
    whole = in_groups(())
    assert "focus_groups_mixed" not in codes(assess_repeatability(whole))
    every = assess_repeatability(in_groups(("P1", "P2", "P3", "P4", "P5")))
    assert Verdict.ROBOT not in verdicts(every)


@pytest.mark.parametrize(("stops", "verdict"), [(6, Verdict.TOO_FEW_CYCLES), (15, Verdict.NOT_STEADY)])
def test_images_of_one_stop_without_a_burst_are_no_cycles(stops: int, verdict: Verdict) -> None:
    data = steady(4, 2 * stops)
    measured = tuple(replace(one, cycle=((one.cycle or 0) + 1) // 2) for one in data.measured)
    found = assess_repeatability(replace(data, measured=measured))
    assert "cycles_repeated" in codes(found)
    assert found.tags.counts["P1"] == (2 * stops, stops)
    assert set(verdicts(found)) == {verdict}
    assert decision(data, found) is Decision.INCONCLUSIVE
    (lacking,) = [one for one in found.warnings if one.code == "distances_unavailable"]
    assert "numbered cycles in common" not in lacking.detail


def test_a_steady_session_has_no_such_warnings() -> None:
    found = assess_repeatability(steady(5))
    assert not {"visit_of_another_pose", "focus_groups_mixed", "cycles_repeated", "cycle_displaced"} & codes(
        found
    )
    assert set(verdicts(found)) == {Verdict.ROBOT}


def _copied(data: SessionData, times: int) -> SessionData:
    """Every reading several times, under cycles of their own."""
    n = max(one.cycle or 0 for one in data.measured)
    measured = [
        replace(one, measurement_id=f"{one.measurement_id}-{k}", cycle=(one.cycle or 0) + k * n)
        for k in range(times)
        for one in data.measured
    ]
    return replace(data, measured=tuple(measured))


def test_copies_of_readings_are_no_cycles() -> None:
    data = _copied(steady(11, 10), 3)
    found = assess_repeatability(data)
    assert "visits_copied" in codes(found)
    assert verdicts(found) == [Verdict.NOT_STEADY] * 5
    assert decision(data, found) is Decision.INCONCLUSIVE
    few = assess_repeatability(_copied(steady(11, 5), 6))
    assert verdicts(few) == [Verdict.TOO_FEW_CYCLES] * 5  # of thirty visits, five are different


def test_a_pose_that_is_the_copy_of_another_is_named() -> None:
    data = steady(12)
    others = [one for one in data.measured if one.pose_id != "P2"]
    copy = [
        replace(one, pose_id="P2", measurement_id=f"{one.measurement_id}-2")
        for one in data.measured
        if one.pose_id == "P1"
    ]
    found = assess_repeatability(replace(data, measured=tuple(others + copy)))
    assert found.tags.copied == ("P1", "P2")
    robots = [row.pose_id for row in found.poses if row.figures and row.figures.verdict is Verdict.ROBOT]
    assert robots == ["P3", "P4", "P5"]


def test_one_image_under_two_cycles_is_a_copy() -> None:
    def seen(cycle: int, image: str) -> MeasuredPose:
        one = steady(14, 3).measured[0]
        observation = ImageObservation(f"m{cycle}", "P1", cycle, image, 0, "", None, 9, 9)
        return replace(one, measurement_id=f"m{cycle}", cycle=cycle, image=observation)

    assert visit_tags({"P1": [seen(1, "a"), seen(2, "b")]}).copied == ()
    tags = visit_tags({"P1": [seen(1, "a"), seen(2, "a"), seen(3, "b")]})
    assert tags.copied == ("P1",)
    assert tags.counts == {"P1": (3, 2)}


@pytest.mark.parametrize("step_mm", [0.01, 0.05])
def test_readings_of_a_coarse_display_are_no_copies(step_mm: float) -> None:
    data = steady(13)
    measured = (
        replace(one, position_mm=np.round(one.position_mm / step_mm) * step_mm) for one in data.measured
    )
    assert "visits_copied" not in codes(assess_repeatability(replace(data, measured=tuple(measured))))
