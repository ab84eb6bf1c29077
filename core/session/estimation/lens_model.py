"""The lens model of each focus group's pooled estimate: Brown's, or one beyond it that the images ask for."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np

from core.calibration import (
    GroupEstimate,
    LensChoice,
    LensEvidence,
    ViewStack,
    estimate_group,
    number_labels,
    observed_radius_px,
    select_lens,
)
from core.errors import Advisory, EstimationError, GridposeError, InvalidArgument, NotConverged
from core.geometry import LensModel, fold_radius_px, lens_model_of
from core.session.estimate import FocusGroup
from core.session.model import SessionData

POOLED = ("pooled", "pooled_free_focal")
SESSION_PRIOR = "per_image_session_prior"
OF_ANY_LENS = (*POOLED, SESSION_PRIOR)
MIN_FOLD_RATIO = 1.05
"""Of the observed radius: a model that turns back within it gives some pixels two directions."""
_OF_LENS = ("lens_beyond_brown", "lens_model_not_fitted")
_NAMES: dict[LensModel, str] = {
    "brown": "Brown's",
    "kannala_brandt": "Kannala's and Brandt's",
    "rational": "the rational",
}


def check_asked(estimator: str, lens_model: LensModel | None) -> None:
    """Raise InvalidArgument where a lens model is asked of an estimator that takes Brown's alone."""
    if lens_model not in (None, "brown") and estimator not in OF_ANY_LENS:
        raise InvalidArgument(
            f"The estimator {estimator} takes Brown's lens model alone, not {lens_model}.",
            f"Use estimator={', '.join(POOLED)} or {SESSION_PRIOR} with lens_model.",
        )


def estimate_with_lens(
    name: str,
    views: ViewStack,
    data: SessionData,
    estimator: str,
    repeats: Sequence[Hashable],
    lens_model: LensModel | None,
    *,
    weak: bool,
) -> tuple[GroupEstimate, LensEvidence | None]:
    """Estimate a focus group with the lens model that is asked for, or that its images ask for; and what speaks
    against Brown's, None where that was not looked for.

    Raises what `estimate_group` raises, and NotConverged where the model asked for cannot be fitted.
    """
    if estimator == SESSION_PRIOR:
        # The model is the session's, by all its images together; the lens that is an image's prior is not.
        common, evidence = estimate_with_lens(name, views, data, "pooled", repeats, lens_model, weak=True)
        start = None if lens_model_of(common.camera) == "brown" else common.camera
        found = estimate_group(views, estimator, lens=data.lens, repeats=repeats, lens_start=start, weak=weak)
        of_lens = tuple(one for one in common.warnings if one.code in _OF_LENS)
        return replace(found, warnings=(*found.warnings, *of_lens)), evidence
    brown: GroupEstimate | None = None
    failure: GridposeError | None = None
    try:
        brown = estimate_group(
            views, estimator, lens=data.lens, intrinsics=data.intrinsics, repeats=repeats, weak=weak
        )
    except EstimationError as error:
        failure = error
    if estimator not in POOLED:
        if brown is None:
            assert failure is not None
            raise failure
        return brown, None
    lens = data.lens if brown is None or brown.fit is None else brown.fit.lens
    choice = select_lens(views, number_labels(repeats), lens, brown, lens_model)
    if choice.start is None:
        if lens_model not in (None, "brown"):
            raise NotConverged(
                f"The lens model {lens_model} cannot be fitted to the images of focus group {name!r}.",
                "Add images in which the board reaches the image's edges, or leave lens_model out.",
            )
        if brown is None:
            assert failure is not None
            raise failure
        if choice.evidence is not None and choice.evidence.beyond_brown:
            brown = _with(brown, _beyond_brown(name, choice))
        if choice.evidence is None and lens_model is None:
            brown = _with(brown, _not_examined(name))
        return brown, choice.evidence
    try:
        found = estimate_group(
            views, estimator, lens=lens, repeats=repeats, lens_start=choice.start, weak=weak
        )
    except EstimationError as error:
        if brown is None or lens_model is not None:
            raise
        return _with(brown, _not_fitted(name, choice, error)), choice.evidence
    return (found if lens_model is not None else _with(found, _beyond_brown(name, choice))), choice.evidence


def lens_warnings(group: FocusGroup) -> list[Advisory]:
    """Warn where the lens model turns back within the radius that the images show."""
    observed, fold = observed_radius(group), fold_radius_px(group.estimate.camera)
    if fold is None or fold >= MIN_FOLD_RATIO * observed:
        return []
    return [
        Advisory(
            "lens_model_folds",
            f"The lens model of focus group {group.name!r} turns back {fold:.0f} px from the principal point; its grid "
            f"points reach {observed:.0f} px. Near that radius and beyond it pixels have no direction.",
            "Add images in which the board reaches the image's edges; do not undistort pixels beyond that radius.",
        )
    ]


def observed_radius(group: FocusGroup) -> float:
    """Return how far from the principal point the outermost grid point of a group's images lies, px."""
    return observed_radius_px(group.views.points_px, group.estimate.camera)


def of_one_width(groups: tuple[FocusGroup, ...]) -> tuple[FocusGroup, ...]:
    """Return groups whose poses have as many columns of `common` errors, so that those of two lenses can be compared;
    columns that a lens does not have are 0.
    """
    width = max(group.estimate.common.shape[2] for group in groups)
    if all(group.estimate.common.shape[2] == width for group in groups):
        return groups
    return tuple(
        replace(
            group,
            poses=tuple(
                replace(pose, common=None if pose.common is None else _widened(pose.common, width))
                for pose in group.poses
            ),
        )
        for group in groups
    )


def _widened(common: np.ndarray, width: int) -> np.ndarray:
    padding = np.zeros((6, width - common.shape[1]))
    return np.concatenate([common[:, :-1], padding, common[:, -1:]], axis=1)


def _with(estimate: GroupEstimate, warning: Advisory) -> GroupEstimate:
    return replace(estimate, warnings=(*estimate.warnings, warning))


def _beyond_brown(name: str, choice: LensChoice) -> Advisory:
    evidence = choice.evidence
    why = (
        "its model does not converge on the images"
        if evidence is None
        else f"w = {evidence.statistic:.0f}, {100.0 * evidence.share:.0f} % of the log-likelihood per coordinate"
    )
    what = f"The lens of focus group {name!r} is beyond Brown's model with k1, k2, p1, p2 ({why})"
    if choice.model == "brown":
        return Advisory(
            "lens_beyond_brown",
            f"{what}: the figures, which take Brown's model, may be off by more than is stated.",
            "Leave lens_model out, and use a pooled estimator; with few images at the edge, add some.",
        )
    return Advisory(
        "lens_beyond_brown",
        f"{what}: pooled figures take {_NAMES[choice.model]} model. Calibrations of single images and estimators "
        "without a common camera still take Brown's, and their focal lengths may be off by more than is stated.",
        "Use the pooled estimators with this lens; lens_model=brown shows the figures with Brown's model.",
    )


def _not_examined(name: str) -> Advisory:
    return Advisory(
        "lens_not_examined",
        f"The images of focus group {name!r} are too few, or of too few places, to show whether its lens is beyond "
        "Brown's model, which the figures take.",
        "Take images from several places, the board also at the image's edges.",
    )


def _not_fitted(name: str, choice: LensChoice, error: EstimationError) -> Advisory:
    return Advisory(
        "lens_model_not_fitted",
        f"The lens of focus group {name!r} is beyond Brown's model, and {_NAMES[choice.model]} could not be "
        f"fitted to all images ({error.detail}): figures take Brown's model and may be off by more than is stated.",
        "Add images in which the board reaches the image's edges.",
    )


def is_brown(group: FocusGroup) -> bool:
    """Return whether a group's camera has Brown's lens model."""
    return lens_model_of(group.estimate.camera) == "brown"
