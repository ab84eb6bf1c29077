"""No corner of an AprilGrid under a wrong name, whatever is done to its views; few are lost."""

from __future__ import annotations

from itertools import islice

import pytest

from core.errors import DetectionError
from core.simulation.mutations import MutatedView, mutated_views
from core.targets import detect

VIEWS = 60


@pytest.mark.parametrize("seed", [11])
def test_no_corner_is_named_wrongly(seed: int) -> None:
    wrong, as_stated, measured = [], 0, 0
    for number, view in enumerate(islice(mutated_views(seed, kind="aprilgrid"), VIEWS)):
        as_stated += view.is_as_stated
        count = wrong_names(view)
        if count is not None:
            measured += view.is_as_stated
        if count:
            wrong.append((number, count, view.changes))
    assert not wrong
    # the others lie under several hands and papers, are too small, or stand beside another grid with the same tags
    assert measured > 0.5 * as_stated > 15


def wrong_names(view: MutatedView) -> int | None:
    """How many corners are found under a wrong name; None where the view is refused."""
    try:
        return view.wrong(detect(view.image, view.target))
    except DetectionError:
        return None
