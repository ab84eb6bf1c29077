"""No dot under a wrong name, whatever is done to views of boards of dots; those that are left open may be named so."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from core.errors import DetectionError
from core.simulation.mutations import mutated_view, mutated_views
from core.targets import GridPoints, TargetSpec, detect

VIEWS = 50


@pytest.mark.parametrize("kind", ["circles", "asymmetric_circles"])
def test_no_dot_is_named_wrongly(kind: str) -> None:
    """Bound 0. Of views of the board itself, behind hands and papers or far out of the picture, more than a third are
    measured; of mirrored ones none."""
    outcomes: Counter[tuple[bool, bool]] = Counter()
    for number, view in enumerate(islice(mutated_views(12, kind=kind), VIEWS)):
        try:
            found = detect(view.image, view.target)
        except DetectionError:
            outcomes[view.is_as_stated, False] += 1
            continue
        assert view.wrong(found) == 0, f"view {number}: {view.changes}"
        assert "mirrored" not in view.changes
        outcomes[view.is_as_stated, True] += 1
    assert outcomes[True, True] > (outcomes[True, True] + outcomes[True, False]) / 3 > 7


@pytest.mark.parametrize("kind", ["circles", "asymmetric_circles"])
def test_names_are_wrong_that_no_turn_makes_right(kind: str) -> None:
    view = next(v for v in mutated_views(12, kind=kind) if v.is_as_stated and v.target.rows % 2 == 0)
    target = view.target
    row, column = (a.ravel() for a in np.mgrid[0 : target.rows, 0 : target.columns])
    right = GridPoints(target, 1000, 800, column, row, view.points_px, np.ones(target.size))
    turned = replace(right, column=target.columns - 1 - column, row=target.rows - 1 - row)
    assert view.wrong(right) == 0
    assert view.wrong(turned) == target.size
    assert view.wrong(replace(turned, origin="turned")) == 0
    shifted = replace(right, column=(column + 1) % target.columns, origin="turned")
    assert view.wrong(shifted) > target.size / 2
    inner = column > 0
    part = GridPoints(
        target, 1000, 800, column[inner] - 1, row[inner], view.points_px[inner].copy(), np.ones(inner.sum())
    )
    assert view.wrong(part) == inner.sum()
    part.points_px[3] += 2.0 * (part.points_px[1] - part.points_px[0])
    assert view.wrong(replace(part, origin="unknown", image_width_px=0, image_height_px=0)) == 1


def test_what_is_left_of_a_larger_board_is_not_the_whole_of_a_smaller_one() -> None:
    """The picture's border and a sheet before it leave 3 x 8 places of staggered dots, the last line of which is half
    hidden: a part, if anything, whose names are left open."""
    view = mutated_view(4, 537, "asymmetric_circles")
    assert "beside_asymmetric_circles" in view.changes
    try:
        found = detect(view.image, view.target)
    except DetectionError:
        return
    assert found.origin == "unknown"
    assert view.wrong(found) == 0


def test_a_blot_at_the_end_of_a_line_is_no_dot_of_it() -> None:
    """The picture's border cuts it, too: it draws the map that it is judged by to itself."""
    view = mutated_view(2, 235, "circles")
    found = detect(view.image, view.target)
    assert found.origin == "unknown"
    assert view.wrong(found) == 0


def test_a_blot_over_a_dot_at_a_corner_is_no_larger_dot() -> None:
    """It is not round, as a larger dot is: the part's names stay open."""
    view = mutated_view(811, 11, "circles")
    found = detect(view.image, view.target)
    assert found.origin == "unknown"
    assert view.wrong(found) == 0


def test_a_blurred_grille_of_small_squares_is_no_board() -> None:
    """Blur rounds squares of 8 px; it tells by how much."""
    view = mutated_view(811, 63, "circles")
    with pytest.raises(DetectionError):
        detect(view.image, view.target)


def test_a_mirrored_print_without_its_larger_dot_is_left_open() -> None:
    """A blot joins the larger dot: what is left looks the same in a mirror. Naming an origin would be wrong."""
    view = mutated_view(2, 230, "circles")
    assert view.changes[0] == "mirrored"
    found = detect(view.image, view.target)
    assert found.origin == "turned"
    assert view.wrong(found) == 0
    assert view.wrong(replace(found, origin="known")) == len(found)
    assert view.wrong(replace(found, column=found.column[::-1].copy())) > len(found) / 2


def test_boards_that_a_mirror_leaves_alone_are_not_mirrored() -> None:
    """An odd number of staggered rows has the same dots in a mirror, and so has a plain rectangle."""
    for kind in ("circles", "asymmetric_circles"):
        for view in islice(mutated_views(3, kind=kind), 60):
            if "mirrored" in view.changes and kind == "asymmetric_circles":
                assert view.target.rows % 2 == 0
            assert view.target == TargetSpec(
                kind, view.target.columns, view.target.rows, 30.0, view.target.marker_mm
            )


def test_a_piece_of_a_grille_is_no_board() -> None:
    """A sheet covers all but 6 x 6 places of a grille whose squares the blur has made round, and some beside them."""
    view = mutated_view(812, 94, "circles")
    with pytest.raises(DetectionError):
        detect(view.image, view.target)
