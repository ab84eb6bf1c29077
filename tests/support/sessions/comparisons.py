"""What the comparison of methods takes alongside the views, and sums of what its methods leave."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from core.calibration import GroupEstimate, Reprojection, estimate_group, reprojection
from core.comparison import Failure, MethodResult
from core.errors import GridposeError
from core.targets import GridPoints

NOT_POOLED = Failure(None, "not_asked", "The test is of other methods.", None)


def pooled(views: Sequence[GridPoints], repeats: Sequence[Hashable] | None = None) -> GroupEstimate | Failure:
    try:
        return estimate_group(views, "pooled", repeats=repeats)
    except GridposeError as error:
        return Failure(None, error.code, error.detail, error.advice)


def reprojection_of(found: MethodResult) -> Reprojection:
    together = np.concatenate(found.residuals_px)
    return reprojection(together, np.ones(len(together), dtype=np.bool_))
