"""Which fields of a target mean anything, by its kind."""

from __future__ import annotations

from core.errors import InvalidTarget
from core.targets.specification import TargetSpec

_MEANINGFUL = {
    "chessboard": frozenset[str](),
    "charuco": frozenset({"marker_mm", "dictionary", "legacy_layout"}),
    "circles": frozenset({"marker_mm"}),
    "asymmetric_circles": frozenset({"marker_mm"}),
    "aprilgrid": frozenset({"marker_mm", "dictionary"}),
}
_OF = {
    "marker_mm": "it is the side of a ChArUco board's markers or an AprilGrid's tags, or the diameter of dots",
    "dictionary": "it is of a ChArUco board's markers",
    "legacy_layout": "it is of ChArUco boards of before OpenCV 4.6",
}


def check_fields(target: TargetSpec) -> None:
    """Raise InvalidTarget where a field is set that a target of this kind has not.

    Such a field would change nothing that is printed or looked for: whoever set it meant another kind. `detect` takes
    such targets all the same, so that those stored earlier go on working; ask this of new descriptions.
    """
    for name, meaning in _OF.items():
        value = getattr(target, name)
        if value is None or value is False or name in _MEANINGFUL[target.kind]:
            continue
        raise InvalidTarget(
            f"A target of kind {target.kind!r} has no {name}: {meaning}.",
            f"Leave {name} out, or correct the kind.",
            field=name,
        )
