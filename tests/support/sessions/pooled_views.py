"""What the comparison of methods takes beside the views: their pooled calibration, or why there is none."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

from core.calibration import GroupEstimate, estimate_group
from core.comparison import Failure
from core.errors import GridposeError
from core.targets import GridPoints

NOT_POOLED = Failure(None, "not_asked", "The test is of other methods.", None)


def pooled(views: Sequence[GridPoints], repeats: Sequence[Hashable] | None = None) -> GroupEstimate | Failure:
    try:
        return estimate_group(views, "pooled", repeats=repeats)
    except GridposeError as error:
        return Failure(None, error.code, error.detail, error.advice)
