"""Fields that mean nothing for a kind of target, and dots and markers of impossible sizes, are refused by name."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from core.errors import InvalidTarget
from core.targets.detection import check_detectable
from core.targets.printed_pattern import DotPattern, pattern_of
from core.targets.specification import KINDS, TargetSpec
from core.targets.target_fields import check_fields, spacing_mm

_SET: dict[str, Any] = {"marker_mm": 12.0, "dictionary": "DICT_APRILTAG_36h11", "legacy_layout": True}
_HAS = {
    "chessboard": (),
    "charuco": ("marker_mm", "dictionary", "legacy_layout"),
    "circles": ("marker_mm",),
    "asymmetric_circles": ("marker_mm",),
    "aprilgrid": ("marker_mm", "dictionary"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_takes_its_own_fields_and_no_others(kind: str) -> None:
    check_fields(TargetSpec(kind, 9, 6, 20.0))
    check_fields(TargetSpec(kind, 9, 6, 20.0, **{name: _SET[name] for name in _HAS[kind]}))
    for name in _SET.keys() - _HAS[kind]:
        with pytest.raises(InvalidTarget, match=f"{kind}.*no {name}") as caught:
            check_fields(TargetSpec(kind, 9, 6, 20.0, **{name: _SET[name]}))
        assert caught.value.field == name


@pytest.mark.parametrize(
    ("kind", "apart"), [("circles", 20.0), ("asymmetric_circles", 20.0 * math.sqrt(2.0))]
)
def test_dots_must_leave_a_gap_and_be_seen(kind: str, apart: float) -> None:
    def board(diameter_mm: float | None) -> TargetSpec:
        return TargetSpec(kind, 9, 6, 20.0, diameter_mm)

    for diameter_mm in (None, 0.201 * apart, 0.5 * apart, 0.899 * apart):
        check_detectable(board(diameter_mm))
        pattern = pattern_of(board(diameter_mm), 0.0)
        assert isinstance(pattern, DotPattern)
        assert np.max(pattern.radius_mm) * 2.0 < spacing_mm(board(diameter_mm))
    for diameter_mm in (1e-3, 0.199 * apart, 0.901 * apart, apart, 25.0 * apart):
        with pytest.raises(InvalidTarget, match="diameter") as caught:
            check_detectable(board(diameter_mm))
        assert caught.value.field == "marker_mm"
        assert f"{0.5 * apart:.4g} mm" in (caught.value.advice or "")


def test_the_markers_of_a_charuco_board_must_be_seen() -> None:
    def board(marker_mm: float) -> TargetSpec:
        return TargetSpec("charuco", 9, 6, 20.0, marker_mm, "DICT_5X5_100")

    check_detectable(board(2.0))
    for marker_mm in (1e-5, 1.99):
        with pytest.raises(InvalidTarget, match="marker_mm") as caught:
            check_detectable(board(marker_mm))
        assert caught.value.field == "marker_mm"
