"""Fields that mean nothing for a kind of target are refused, by name."""

from __future__ import annotations

from typing import Any

import pytest

from core.errors import InvalidTarget
from core.targets.specification import KINDS, TargetSpec
from core.targets.target_fields import check_fields

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
