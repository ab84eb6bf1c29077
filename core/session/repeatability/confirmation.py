"""Whether the common camera of a session confirms what other estimators say of its poses.

`per_image`, `per_image_session_prior`, `per_image_fixed_pp` and `given` have noise floors that hold if their camera
model does. A principal point held off its place, or given intrinsics of another focus, move the pose by what differs
between images, and the floor does not contain it. So their verdict `robot` is withheld from a pose

- whose images the model does not fit: residuals larger than the noise of repeats explains, by far;
- whose reading the common camera of the same images (`pooled`) explains by the instrument, or does not explain at all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from core.errors import Advisory, FocalNotObservable, GridposeError, listed
from core.metrology import PoseRepeatability, Verdict
from core.session.estimate import SessionEstimate
from core.session.estimation import estimate_session
from core.session.model import SessionData, natural

UNCONFIRMED_ESTIMATORS = ("per_image", "per_image_session_prior", "per_image_fixed_pp", "given")
MAX_MISFIT = 4.0
"""Variance of the residuals over that of the noise that repeats show: beyond it the camera model is rejected."""

Figures = Mapping[str, PoseRepeatability]


def unconfirmed(
    data: SessionData,
    estimate: SessionEstimate,
    figures_of: Callable[[SessionEstimate], Figures],
) -> tuple[frozenset[str], tuple[Advisory, ...]]:
    """Return the poses whose verdict `robot` is not confirmed, and warnings that say why.

    `figures_of` an estimate are its poses' figures, by pose.
    """
    if estimate.estimator not in UNCONFIRMED_ESTIMATORS:
        return frozenset(), ()
    claimed = {pose_id for pose_id, found in figures_of(estimate).items() if _claims_robot(found)}
    if not claimed:
        return frozenset(), ()
    misfits = {
        pose.pose_id: group.estimate.misfit
        for group in estimate.groups
        if group.estimate.misfit > MAX_MISFIT
        for pose in group.poses
    }
    rejected = set(misfits) & claimed
    warnings = []
    if rejected:
        worst = max(misfits[pose_id] for pose_id in rejected)
        warnings.append(
            Advisory(
                "verdict_withheld",
                f"The residuals of estimator {estimate.estimator} have {worst:.0f} times the variance of the noise "
                f"that repeats show: its camera model does not fit the images of {_named(rejected)}, and the verdict "
                "robot is withheld.",
                "Use estimator=pooled, or give intrinsics of this very focus.",
            )
        )
    contradicted = _contradicted(data, estimate.estimator, claimed, figures_of) - rejected
    if contradicted:
        warnings.append(
            Advisory(
                "verdict_withheld",
                f"The common camera of the same images (estimator pooled) does not confirm that the scatter of "
                f"{_named(contradicted)} is the robot's: by it the instrument has a share, and the verdict robot of "
                f"estimator {estimate.estimator} is withheld.",
                "Compare the figures with those of estimator=pooled.",
            )
        )
    return frozenset(rejected | contradicted), tuple(warnings)


def _contradicted(
    data: SessionData, estimator: str, claimed: set[str], figures_of: Callable[[SessionEstimate], Figures]
) -> set[str]:
    """Return the poses that are not the robot's by the common camera, or have no common camera."""
    try:
        pooled = figures_of(estimate_session(data, "pooled"))
    except FocalNotObservable:
        # Known intrinsics need no focal length from the images; a camera of its own for each image does.
        return set() if estimator == "given" else claimed
    except GridposeError:
        return claimed
    return claimed - {pose_id for pose_id, found in pooled.items() if found.verdict == Verdict.ROBOT}


def _claims_robot(figures: PoseRepeatability) -> bool:
    return Verdict.ROBOT in [verdict for _, verdict in figures.verdicts.items()]


def _named(pose_ids: set[str]) -> str:
    return f"{'pose' if len(pose_ids) == 1 else 'poses'} {listed(sorted(pose_ids, key=natural))}"
