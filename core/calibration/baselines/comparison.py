"""The rows of Table II: every method on the same grid points, with the images it fails on and why."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from core.calibration.baselines.dlt import dlt
from core.calibration.baselines.opencv import opencv_single_image, zhang
from core.calibration.baselines.proposed import VARIANTS, proposed
from core.calibration.baselines.result import Baseline
from core.calibration.baselines.tsai import tsai
from core.calibration.result import Reprojection
from core.calibration.uncertainty import reprojection
from core.errors import DegenerateGeometry, GridposeError
from core.targets.specification import GridPoints

SINGLE_VIEW: dict[str, Callable[[GridPoints], Baseline]] = {
    **{method: partial(proposed, method) for method in VARIANTS},
    "opencv_single_image": opencv_single_image,
    "tsai": tsai,
    "dlt": dlt,
}
CALIBRATION_METHODS = (*VARIANTS, "zhang", "opencv_single_image", "tsai", "dlt")
"""The order of the rows."""


@dataclass(frozen=True, slots=True)
class Failure:
    """What went wrong on one image, by its index; None where it is the images together."""

    image: int | None
    code: str
    detail: str
    advice: str | None


@dataclass(frozen=True, slots=True)
class MethodRow:
    """One method over all images: `reprojection` over all points of those it answered for, None where there are none.

    `answers` has the index of each answered image and its answer; a method that takes the images together has one,
    with index None.
    """

    method: str
    images: int
    reprojection: Reprojection | None
    answers: tuple[tuple[int | None, Baseline], ...]
    failures: tuple[Failure, ...]

    @property
    def failure(self) -> Failure | None:
        """Why there is no answer at all, or None."""
        return self.failures[0] if self.failures and not self.answers else None


def compare_calibrations(views: Sequence[GridPoints]) -> tuple[MethodRow, ...]:
    """Calibrate by every method; `views` are the images of one camera setting (one focus group)."""
    return tuple(_row(method, views) for method in CALIBRATION_METHODS)


def _row(method: str, views: Sequence[GridPoints]) -> MethodRow:
    answers: list[tuple[int | None, Baseline]] = []
    failures = []
    attempts: list[tuple[int | None, Callable[[], Baseline]]]
    if method == "zhang":
        attempts = [(None, partial(zhang, views))]
    else:
        attempts = [(index, partial(SINGLE_VIEW[method], points)) for index, points in enumerate(views)]
    for index, attempt in attempts:
        try:
            answers.append((index, attempt()))
        except GridposeError as error:
            failures.append(Failure(index, error.code, error.detail, error.advice))
        except (np.linalg.LinAlgError, ArithmeticError):
            unnamed = DegenerateGeometry("The grid points found do not determine the camera and its pose.")
            failures.append(Failure(index, unnamed.code, unnamed.detail, unnamed.advice))
    residuals = [r for _, answer in answers for r in answer.residuals_px]
    together = np.concatenate(residuals) if residuals else np.zeros((0, 2))
    return MethodRow(
        method=method,
        images=sum(len(answer.residuals_px) for _, answer in answers),
        reprojection=reprojection(together, np.ones(len(together), dtype=np.bool_)) if residuals else None,
        answers=tuple(answers),
        failures=tuple(failures),
    )
