"""Poses for absolute figures (AP, AD, frames): before prints that may depart from their nominal grid.

Repeatability compares visits to one pose, from which the print's scale and shape cancel; it takes the poses as they
are estimated. Positions between poses do not: for them the poses move to where the departures that the images show
put them, all visits of a pose by the same motion, and share what the departures leave open
(`core.calibration.target_shape.marginal_poses`).

A pitch that is .1 % wrong makes every length .1 % wrong, and no image shows it. Before a target whose scale nobody
states, AP and AD keep their values and have no interval.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.calibration import LENS, PRINT_SCALE, PRINT_SHAPE, MarginalPoses, ShapePrior, marginalise_shape
from core.errors import Advisory, listed
from core.geometry import so3_exp
from core.session.estimate import FocusGroup, SessionEstimate, in_order
from core.session.model import MeasuredPose, SessionData

MAX_SHAPE_SHARE = 2.0
"""Of the uncertainty of positions between poses, to that of the camera alone, beyond which the print dominates."""


@dataclass(frozen=True, slots=True)
class AbsolutePoses:
    """The session's poses by measurement, and what to know of the print.

    `sources` says of which error each column of their `common` is: `lens`, `print_scale` or `print_shape`.
    """

    poses: Mapping[str, MeasuredPose]
    sources: tuple[str, ...]
    warnings: tuple[Advisory, ...]


def absolute_poses(
    data: SessionData, estimate: SessionEstimate, priors: Mapping[int, ShapePrior] | None = None
) -> AbsolutePoses:
    """Return the poses of all images with the departures of their prints marginalised.

    `priors` by the target's place in the session's list; those that are not given are what the estimate left open, or
    follow from the targets. Only the
    pooled estimator has one camera to which all images say what a print departs by; poses of others stay as they are.
    """
    known = {**estimate.shapes, **(priors or {})}
    each = [_marginal(data, group, known) for group in estimate.groups]
    sources = [_sources(group, marginal) for group, marginal in zip(estimate.groups, each, strict=True)]
    widths = [len(of_group) for of_group in sources]
    found: dict[str, MeasuredPose] = {}
    dominated = []
    for g, (group, marginal) in enumerate(zip(estimate.groups, each, strict=True)):
        columns = ((0, 0), (sum(widths[:g]), sum(widths[g + 1 :])))
        if marginal is None:
            for pose in group.poses:
                common = None if pose.common is None else np.pad(pose.common, columns)
                found[pose.measurement_id] = replace(pose, common=common)
            continue
        scaled = any(stated_scale(data, known, pose) is not None for pose in group.poses)
        # Figures of unknown scale have no uncertainty that the print's shape could dominate.
        if scaled and _shape_share(marginal) > MAX_SHAPE_SHARE:
            dominated.append(group.name)
        turns = [so3_exp(w) for w in marginal.turned]
        shared = [np.pad(common, columns) for common in marginal.common]
        covariances = [common @ common.T for common in shared]
        before = group.estimate.common
        own = group.estimate.covariance - before @ np.swapaxes(before, 1, 2)
        for k, (pose, place) in enumerate(zip(group.poses, marginal.place.tolist(), strict=True)):
            assert pose.rotation is not None  # poses of images have one
            found[pose.measurement_id] = replace(
                pose,
                position_mm=pose.position_mm + marginal.moved_mm[place],
                rotation=turns[place] @ pose.rotation,
                covariance=own[k] + covariances[place],
                common=shared[place],
            )
    warnings = (*scale_warnings(data, estimate, known), *_shape_warnings(dominated))
    return AbsolutePoses(found, tuple(one for of_group in sources for one in of_group), warnings)


def with_print_uncertainty(data: SessionData, estimate: SessionEstimate) -> SessionEstimate:
    """Return the estimate with what prints may depart by in the uncertainties of cameras and of poses.

    The values stay, so that camera and poses agree with the images as they are: the uncertainty is that about them, of
    what the departures found do and of what they leave open. With other estimators than the pooled one, and where the
    shape of the print was estimated, the estimate stays as it is.
    """
    if estimate.shapes:
        return estimate
    groups = tuple(_with_print(group, _marginal(data, group, {})) for group in estimate.groups)
    return replace(estimate, groups=groups, poses=in_order(data, groups))


def _with_print(group: FocusGroup, marginal: MarginalPoses | None) -> FocusGroup:
    if marginal is None:
        return group
    before = group.estimate
    moved = np.concatenate([marginal.moved_mm, marginal.turned], axis=1)[:, :, None]
    of_shape = marginal.common[:, :, [source == PRINT_SHAPE for source in marginal.sources]]
    added = np.concatenate([of_shape, moved], axis=2)[marginal.place]
    camera = before.camera_covariance.copy()
    free = len(marginal.camera_moved)
    camera[:free, :free] += marginal.camera_of_print + np.outer(marginal.camera_moved, marginal.camera_moved)
    covariance = before.covariance + added @ np.swapaxes(added, 1, 2)
    common = np.concatenate([before.common, added], axis=2)
    poses = tuple(
        replace(pose, covariance=covariance[k], common=common[k]) for k, pose in enumerate(group.poses)
    )
    found = replace(before, camera_covariance=camera, covariance=covariance, common=common)
    return replace(group, estimate=found, poses=poses)


def _marginal(data: SessionData, group: FocusGroup, priors: Mapping[int, ShapePrior]) -> MarginalPoses | None:
    fit = group.estimate.fit
    if fit is None:
        return None
    places = [data.targets.index(target) for target in fit.views.targets]
    return marginalise_shape(
        fit,
        [priors.get(p, ShapePrior.of(t)) for p, t in zip(places, fit.views.targets, strict=True)],
    )


def _sources(group: FocusGroup, marginal: MarginalPoses | None) -> tuple[str, ...]:
    if marginal is not None:
        return marginal.sources
    return (*[LENS] * (group.estimate.common.shape[2] - 1), PRINT_SCALE)


def _shape_share(marginal: MarginalPoses) -> float:
    """Return the uncertainty of positions between poses over that which the camera alone leaves, by root mean square;
    1 where there is one pose.
    """

    def between(common: Float[np.ndarray, "m 6 e"]) -> float:
        positions = common[:, :3]
        return float(np.sum((positions - positions.mean(axis=0)) ** 2))

    alone = between(marginal.of_camera)
    return float(np.sqrt(between(marginal.common) / alone)) if alone > 0.0 else 1.0


def scale_warnings(
    data: SessionData, estimate: SessionEstimate, priors: Mapping[int, ShapePrior]
) -> list[Advisory]:
    """Name the targets whose pitch is taken as exact; `priors` as of `absolute_poses`."""
    shown = {pose.frame: pose for pose in estimate.poses}
    exact = [data.target_ids[k] for k in sorted(shown) if stated_scale(data, priors, shown[k]) is None]
    if not exact:
        return []
    return [
        Advisory(
            "scale_taken_as_exact",
            f"Neither a certificate nor the pitch's standard uncertainty is stated of {listed(exact)}: lengths take "
            "the pitch as exact, a pitch 1e-4 too long makes every length 1e-4 too long, and no uncertainty contains "
            "it.",
            "State the target's certificate or pitch_standard_uncertainty_mm.",
        )
    ]


def _shape_warnings(dominated: Sequence[str]) -> list[Advisory]:
    if not dominated:
        return []
    return [
        Advisory(
            "target_shape_dominates",
            "What the shape of the print leaves open is the larger part of the uncertainty of absolute figures (AP, "
            f"AD) of focus group {', '.join(map(repr, dominated))}.",
            "Add four views of the target tilted by 20° to 40° to different sides, as poses near the cube in every "
            "cycle.",
        )
    ]


def stated_scale(data: SessionData, shapes: Mapping[int, ShapePrior], visit: MeasuredPose) -> float | None:
    """Return the relative standard uncertainty of the print's scale; None for another instrument, or not stated.

    `shapes` as of `core.session.assess_repeatability`.
    """
    if visit.image is None:
        return None
    return shapes.get(visit.frame, ShapePrior.of(data.targets[visit.frame])).scale


def scale_unknown(data: SessionData, shapes: Mapping[int, ShapePrior], visit: MeasuredPose) -> bool:
    """Return whether the visit is to a print of which no scale is stated; `shapes` as of `stated_scale`."""
    return visit.image is not None and stated_scale(data, shapes, visit) is None
