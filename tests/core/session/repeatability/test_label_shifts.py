"""Visits whose board was counted from another of its points: named by the shift, and no robot's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.geometry import so3_exp
from core.metrology import find_label_shifts
from core.session import ImageObservation, MeasuredPose
from core.session.model import CameraMount
from core.session.repeatability.visit_tags import tag_warnings, visit_tags
from core.targets import TargetSpec
from tests.support.simulation import session_cycles as made

BOARD = TargetSpec("charuco", 12, 9, 17.0, 12.0, "DICT_5X5_250")
DOTS = TargetSpec("asymmetric_circles", 4, 11, 20.0)


def _visits(
    seed: int, off: dict[int, np.ndarray], mount: CameraMount = "robot"
) -> dict[str, list[MeasuredPose]]:
    """Fifteen visits to three poses; those of P2 in these cycles are off by so much in the board's axes."""
    found: dict[str, list[MeasuredPose]] = {}
    R = so3_exp(np.array([0.4, -0.2, 0.3]))
    for one in made.measured_session(made.gaussian(np.random.default_rng(seed), 15, 3)).measured:
        image = ImageObservation(
            one.measurement_id, one.pose_id, one.cycle, one.measurement_id, 0, "", None, 9, 9
        )
        d = off.get(one.cycle or 0, np.zeros(3)) if one.pose_id == "P2" else np.zeros(3)
        d = d if mount == "robot" else R @ d
        moved = replace(one, image=image, rotation=R, position_mm=one.position_mm + d)
        found.setdefault(one.pose_id, []).append(moved)
    return found


@pytest.mark.parametrize("mount", ["robot", "fixed"])
@pytest.mark.parametrize(
    ("board", "shift"),
    [(BOARD, (17.0, 0.0)), (BOARD, (-34.0, 17.0)), (DOTS, (20.0, 20.0)), (DOTS, (0.0, 40.0))],
)
def test_boards_counted_off_are_named(
    board: TargetSpec, shift: tuple[float, float], mount: CameraMount
) -> None:
    off = np.array([*shift, 0.0])
    tags = visit_tags(_visits(1, {4: off, 9: off}, mount), (board,), mount)
    assert [(one.visit.pose_id, one.visit.cycle, one.shift_mm) for one in tags.mistaken] == [
        ("P2", 4, shift),
        ("P2", 9, shift),
    ]
    assert tags.flaw("P2") is not None
    assert tags.flaw("P1") is None
    (warning,) = tag_warnings(tags)
    assert warning.code == "visit_label_shifted"
    assert f"P2 cycle 9 ({shift[0]:g} mm along x, {shift[1]:g} mm along y)" in warning.detail


@pytest.mark.parametrize(
    "off", [(8.0, 0.0, 0.0), (17.0, 0.0, 17.0), (12.0, 12.0, 0.0), (20.0, 0.0, 0.0)], ids=str
)
def test_slips_are_no_miscounted_boards(off: tuple[float, float, float]) -> None:
    assert not visit_tags(_visits(2, {4: np.array(off)}), (BOARD,)).mistaken


def test_dots_have_no_places_between_their_rows() -> None:
    assert not visit_tags(_visits(3, {4: np.array([20.0, 0.0, 0.0])}), (DOTS,)).mistaken


def test_scatter_as_large_as_a_pitch_says_nothing() -> None:
    rng = np.random.default_rng(5)
    positions = rng.normal(0.0, 1.0, (15, 3))
    positions[3] += (170.0, 0.0, 0.0)
    assert find_label_shifts(0.1 * positions, BOARD.points_target()) == {3: (17.0, 0.0)}
    assert find_label_shifts(positions, BOARD.points_target()) == {}
