"""Which fields of a target mean anything, by its kind, and how large its markers or dots may be."""

from __future__ import annotations

import math

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

MIN_DOT_RATIO, MAX_DOT_RATIO = 0.2, 0.9
"""A dot's diameter over the distance to the next dot. Wider dots merge in the image, and of smaller
ones the neighbours are too many radii away (`core.targets.circles.lattice`); within these bounds sharp views, flat and
tilted, are found."""
MIN_MARKER_RATIO = 0.1
"""A ChArUco marker's side over the pitch. A smaller one's cells are less than a sixtieth of a square wide: no lens that
has the whole board in view resolves them."""


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


def spacing_mm(target: TargetSpec) -> float:
    """Return the distance of nearest grid points (of tags, for an AprilGrid), mm."""
    return target.pitch_mm * (math.sqrt(2.0) if target.kind == "asymmetric_circles" else 1.0)


def check_marker_size(target: TargetSpec) -> None:
    """Raise InvalidTarget for dots that touch or vanish, and for ChArUco markers that vanish.

    What else must be so of markers and tags: `core.targets.charuco.layout`, `core.targets.aprilgrid.layout`.
    """
    size = target.marker_mm
    if size is None:
        return
    if target.kind in ("circles", "asymmetric_circles"):
        apart = spacing_mm(target)
        if not MIN_DOT_RATIO * apart <= size <= MAX_DOT_RATIO * apart:
            raise InvalidTarget(
                f"marker_mm, the dots' diameter, must be {MIN_DOT_RATIO:g} to {MAX_DOT_RATIO:g} of their distance of "
                f"{apart:.4g} mm, or they merge or are not detected; got {size:g} mm.",
                f"Half the distance serves best: {0.5 * apart:.4g} mm, which is the default.",
                field="marker_mm",
            )
    if target.kind == "charuco" and size < MIN_MARKER_RATIO * target.pitch_mm:
        raise InvalidTarget(
            f"A ChArUco board's marker_mm must be {MIN_MARKER_RATIO:g} of its pitch_mm at least, or its cells are "
            f"too small to be seen; got {size:g} mm.",
            "Make it two thirds to three quarters of the pitch, or state what the print has.",
            field="marker_mm",
        )
