"""Why distances between poses are not given: the reason and the advice are those of the poses at hand."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from core.session.model import CommandedPose, MeasuredPose
from core.session.repeatability.performance import assess_performance

PLACES = {"P1": (0.0, 0.0, 0.0), "P2": (80.0, 0.0, 0.0), "P3": (0.0, 90.0, 0.0)}
FURTHER = {f"P{i}": (80.0 * i, 0.0, 0.0) for i in range(4, 13)}
CYCLES = (1, 2, 3, 4)


def visits(
    pose_id: str, cycles: tuple[int | None, ...] = CYCLES, *, scatter_mm: float = 0.05, frame: int = 0
) -> list[MeasuredPose]:
    rng = np.random.default_rng(sum(map(ord, pose_id)))
    return [
        MeasuredPose(
            f"{pose_id}.{place}",
            pose_id,
            cycle,
            None,
            np.array({**PLACES, **FURTHER}[pose_id]) + rng.normal(0.0, scatter_mm, 3),
            np.eye(3),
            None,
            None,
            frame=frame,
        )
        for place, cycle in enumerate(cycles)
    ]


def said(measured: Mapping[str, list[MeasuredPose]], **settings: bool) -> tuple[str, str]:
    found = assess_performance(measured, measured, {}, **settings)
    assert not found.distances
    (warning,) = found.warnings
    assert warning.code == "distances_unavailable"
    assert warning.advice is not None
    return warning.detail, warning.advice


@pytest.mark.parametrize(
    ("second", "reason", "advice"),
    [
        (visits("P2", (1,)), "fewer than two visits", "Visit every pose again"),
        (visits("P2", frame=1), "before different targets", "before the same target"),
        (visits("P2", (None,) * 4), "fewer than two numbered cycles in common", "with its cycle"),
        (visits("P2", (5, 6, 7, 8)), "fewer than two numbered cycles in common", "with its cycle"),
        (visits("P2", scatter_mm=9.0), "the scatter of their positions", "farther apart"),
    ],
)
def test_the_advice_is_what_mends_the_reason(second: list[MeasuredPose], reason: str, advice: str) -> None:
    found = said({"P1": visits("P1"), "P2": second})
    assert found[0].startswith("Distances are not given. P1-P2: ")
    assert reason in found[0]
    assert advice in found[1]
    assert found[1].count(".") == 1, "one advice for one reason"


def test_scatter_of_a_camera_for_each_image_is_not_mended_by_tags_or_other_poses() -> None:
    measured = {pose_id: visits(pose_id, scatter_mm=9.0) for pose_id in PLACES}
    detail, advice = said(measured, one_camera=False)
    assert "P1-P2, P1-P3, P2-P3" in detail
    assert "camera for each image" in detail
    assert advice == "Take one camera for all images (estimator=pooled)."


def test_poses_that_lack_different_things_are_named_by_what_they_lack() -> None:
    detail, advice = said({"P1": visits("P1"), "P2": visits("P2", (1,)), "P3": visits("P3", frame=1)})
    assert "P1-P2, P2-P3: one of the two poses has fewer than two visits" in detail
    assert "P1-P3: the poses are before different targets" in detail
    assert advice.index("Visit every pose again") < advice.index("before the same target")


def test_of_many_poses_the_pairs_that_have_a_distance_are_counted_and_the_others_named() -> None:
    """Twelve poses, of which three were visited more than once."""
    measured = {name: visits(name) for name in PLACES} | {name: visits(name, (1,)) for name in FURTHER}
    found = assess_performance(measured, measured, {})
    assert len(found.distances) == 2
    (warning,) = (w for w in found.warnings if w.code == "distance_pairs_truncated")
    assert "the 11 pairs of successive ones" in warning.detail
    assert "between 2 of these pairs. P3-P4, " in warning.detail
    assert "fewer than two visits that count" in warning.detail


def test_directions_of_approach_take_no_distance_between_test_poses() -> None:
    """A test by ISO 9283 with three directions has 18 poses; its distance is that from P2 to P4 (7.3)."""
    names = [f"P{k}" for k in range(1, 6)]
    measured, commanded = {}, {}
    for name in names:
        place = {**PLACES, **FURTHER}[name]
        for way in (None, "x", "y", "z") if name in ("P1", "P2", "P4") else (None,):
            pose_id = name if way is None else f"{name}_from_{way}"
            measured[pose_id] = visits(name)
            commanded[pose_id] = CommandedPose(list(place), 0.0, 0.0, 0.0, approach=way)
    found = assess_performance(measured, measured, commanded)
    ends = [(one.from_pose_id, one.to_pose_id) for one in found.distances]
    assert ends == [(a, b) for k, a in enumerate(names) for b in names[k + 1 :]]
    assert len(found.approaches) == 3
    assert not [one for one in found.warnings if one.code.startswith("distance")]
