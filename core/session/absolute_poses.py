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

from core.calibration import (
    LENS,
    MAX_DETERMINED_UNCERTAINTY,
    PRINT_SCALE,
    PRINT_SHAPE,
    MarginalPoses,
    ShapePrior,
    focal_weakly_observable,
    marginalise_shape,
)
from core.errors import Advisory, listed
from core.geometry import so3_exp
from core.session.estimate import FocusGroup, SessionEstimate, in_order
from core.session.model import MeasuredPose, SessionData

SHAPE_DOMINATES = "target_shape_dominates"
MAX_SHAPE_SHARE = 2.0
"""Of the uncertainty of positions between poses, to that of the camera alone, beyond which the print dominates."""


@dataclass(frozen=True, slots=True)
class AbsolutePoses:
    """The session's poses by measurement, and what to know of the print.

    `sources` says of which error each column of their `common` is: `lens`, `print_scale` or `print_shape`. `cameras`
    are the covariances of the focus groups' cameras, with what the prints may depart by.
    """

    poses: Mapping[str, MeasuredPose]
    sources: tuple[str, ...]
    cameras: tuple[Float[np.ndarray, "s s"], ...]
    warnings: tuple[Advisory, ...]


def absolute_poses(
    data: SessionData, estimate: SessionEstimate, priors: Mapping[int, ShapePrior] | None = None
) -> AbsolutePoses:
    """Return the poses of all images with the departures of their prints marginalised.

    `priors` by the target's place in the session's list; those that are not given are what the estimate left open, or
    follow from the targets. Only the pooled estimator has one camera to which all images say what a print departs by;
    poses of others stay as they are. Each focus group has a lens of its own, and what its images leave open of a print;
    the scale of a print is one error of all groups.
    """
    known = {**estimate.shapes, **(priors or {})}
    each = [_marginal(group, known) for group in estimate.groups]
    sources = [_sources(group, marginal) for group, marginal in zip(estimate.groups, each, strict=True)]
    widths = [sum(source != PRINT_SCALE for source in of_group) for of_group in sources]
    scales = max((len(of_group) - width for of_group, width in zip(sources, widths, strict=True)), default=0)
    found: dict[str, MeasuredPose] = {}
    dominated = []
    for g, (group, marginal) in enumerate(zip(estimate.groups, each, strict=True)):
        before = group.estimate.common
        positions = group.estimate.positions_mm
        if marginal is None:
            sign = _signs(sources[g], before, positions)
        else:
            sign = _signs(
                sources[g], marginal.common, positions[np.unique(marginal.place, return_index=True)[1]]
            )
        columns = _Columns(sign, sum(widths[:g]), sum(widths), sum(widths) + scales)
        if marginal is None:
            for pose in group.poses:
                alone = None if pose.common is None else columns.of(pose.common)
                found[pose.measurement_id] = replace(pose, common=alone)
            continue
        scaled = any(stated_scale(data, known, pose) is not None for pose in group.poses)
        # Figures of unknown scale have no uncertainty that the print's shape could dominate.
        of_camera, of_both = _between_poses(marginal)
        if scaled and of_both > MAX_SHAPE_SHARE * of_camera > 0.0:
            dominated.append((group.name, of_camera, of_both))
        # Images of one pose share its errors: one array for all of them.
        shared = [columns.of(of_place) for of_place in marginal.common]
        place = marginal.place
        turns = np.array([so3_exp(w) for w in marginal.turned])[place]
        covariance = group.estimate.covariance - before @ np.swapaxes(before, 1, 2)
        covariance = covariance + np.array([C @ C.T for C in shared])[place]
        rotations = turns @ group.estimate.rotations
        positions = positions + marginal.moved_mm[place]
        for k, (pose, m) in enumerate(zip(group.poses, place.tolist(), strict=True)):
            found[pose.measurement_id] = replace(
                pose,
                position_mm=positions[k],
                rotation=rotations[k],
                covariance=covariance[k],
                common=shared[m],
            )
    names = [source for of_group in sources for source in of_group if source != PRINT_SCALE]
    warnings = (*unstated_scale_warnings(data, estimate, known), *_shape_warnings(dominated))
    cameras = tuple(
        _camera_covariance(group, marginal) for group, marginal in zip(estimate.groups, each, strict=True)
    )
    return AbsolutePoses(found, (*names, *[PRINT_SCALE] * scales), cameras, warnings)


def stacked_errors(poses: Sequence[MeasuredPose]) -> Float[np.ndarray, "n 6 k"] | None:
    """Return the factors of the errors that absolute poses share; None where no pose has any."""
    found = [pose.common for pose in poses if pose.common is not None]
    if len(found) < len(poses):
        return None
    common = np.array(found)
    common = common[:, :, np.any(common != 0.0, axis=(0, 1))]
    return np.ascontiguousarray(common) if common.shape[2] else None


@dataclass(frozen=True, slots=True)
class _Columns:
    """Where the common errors of a focus group have their columns: its own from `first` on, before those of the prints'
    scale, which begin at `scale` and are the same errors in all groups; `size` in all. `sign` is of the group's errors:
    0 of its own, of those of scale the sign with which they lengthen its positions.
    """

    sign: Float[np.ndarray, " e"]
    first: int
    scale: int
    size: int

    def of(self, common: Float[np.ndarray, "6 e"]) -> Float[np.ndarray, "6 k"]:
        """Return a pose's common errors in their columns."""
        placed = np.zeros((6, self.size))
        own, of_scale = common[:, self.sign == 0.0], common[:, self.sign != 0.0]
        placed[:, self.first : self.first + own.shape[1]] = own
        placed[:, self.scale : self.scale + of_scale.shape[1]] = of_scale * self.sign[self.sign != 0.0]
        return placed


def _signs(
    sources: Sequence[str], common: Float[np.ndarray, "m 6 e"], positions_mm: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, " e"]:
    lengthened = np.einsum("mce,mc->e", common[:, :3], positions_mm)
    of_scale = np.array([source == PRINT_SCALE for source in sources])
    return np.where(of_scale, np.where(lengthened < 0.0, -1.0, 1.0), 0.0)


def with_print_uncertainty(data: SessionData, estimate: SessionEstimate) -> SessionEstimate:
    """Return the estimate with what prints may depart by in the uncertainties of cameras and of poses.

    The values stay, so that camera and poses agree with the images as they are: the uncertainty is that about them, of
    what the departures found do and of what they leave open. With other estimators than the pooled one the estimate
    stays as it is. A camera that is weakly determined only with the print's part is warned of.
    """
    groups = tuple(_with_print(group, _marginal(group, estimate.shapes)) for group in estimate.groups)
    weak = [
        focal_weakly_observable(
            f"What the print may depart by in shape leaves the camera of focus group {after.name!r} with",
            after.estimate.focal_relative_uncertainty,
            "Add images with the target tilted by 20° to 40° to different sides, or state print_kind or a certificate.",
        )
        for before, after in zip(estimate.groups, groups, strict=True)
        if before.estimate.focal_relative_uncertainty <= MAX_DETERMINED_UNCERTAINTY
        and after.estimate.focal_relative_uncertainty > MAX_DETERMINED_UNCERTAINTY
    ]
    return replace(
        estimate, groups=groups, poses=in_order(data, groups), warnings=(*estimate.warnings, *weak)
    )


def _with_print(group: FocusGroup, marginal: MarginalPoses | None) -> FocusGroup:
    if marginal is None:
        return group
    before, place = group.estimate, marginal.place
    moved = np.concatenate([marginal.moved_mm, marginal.turned], axis=1)[:, :, None]
    of_shape = marginal.common[:, :, [source == PRINT_SHAPE for source in marginal.sources]]
    added = np.concatenate([of_shape, moved], axis=2)[place]
    of_scale = marginal.common[:, :3, [source == PRINT_SCALE for source in marginal.sources]][place]
    # Of the scale what the print's aspect says in addition to what is stated: one error of each print, the last.
    stated = np.sum(before.common[:, :3, -1] ** 2, axis=1)
    further = np.maximum(np.sum(of_scale**2, axis=(1, 2)) - stated, 0.0)
    lengths = np.maximum(np.linalg.norm(before.positions_mm, axis=1), 1e-12)
    scale = np.zeros_like(before.common[:, :, -1:])
    scale[:, :3, 0] = before.positions_mm * (np.sqrt(stated + further) / lengths)[:, None]
    camera = _camera_covariance(group, marginal)
    common = np.concatenate([before.common[:, :, :-1], added, scale], axis=2)
    grown = common @ np.swapaxes(common, 1, 2) - before.common @ np.swapaxes(before.common, 1, 2)
    covariance = before.covariance + grown
    poses = tuple(
        replace(pose, covariance=covariance[k], common=common[k]) for k, pose in enumerate(group.poses)
    )
    found = replace(before, camera_covariance=camera, covariance=covariance, common=common)
    return replace(group, estimate=found, poses=poses)


def _camera_covariance(group: FocusGroup, marginal: MarginalPoses | None) -> Float[np.ndarray, "s s"]:
    """Return the covariance of the camera about its value, with what the departures found do and leave open."""
    camera = group.estimate.camera_covariance.copy()
    if marginal is not None:
        free = len(marginal.camera_moved)
        camera[:free, :free] += marginal.camera_of_print + np.outer(
            marginal.camera_moved, marginal.camera_moved
        )
    return camera


def _marginal(group: FocusGroup, priors: Mapping[int, ShapePrior]) -> MarginalPoses | None:
    fit = group.estimate.fit
    if fit is None:
        return None
    # Two prints of one description are two prints: what is known of them goes by their places in the session.
    places = {k: pose.frame for k, pose in zip(fit.views.target.tolist(), group.poses, strict=True)}
    return marginalise_shape(
        fit,
        [
            priors[places[k]] if places.get(k) in priors else ShapePrior.of(target)
            for k, target in enumerate(fit.views.targets)
        ],
    )


def _sources(group: FocusGroup, marginal: MarginalPoses | None) -> tuple[str, ...]:
    if marginal is not None:
        return marginal.sources
    return (*[LENS] * (group.estimate.common.shape[2] - 1), PRINT_SCALE)


def _between_poses(marginal: MarginalPoses) -> tuple[float, float]:
    """Return the standard uncertainty of positions between poses that the camera alone leaves, and the one that camera
    and the print's shape leave, root mean square, mm; 0 where there is one pose.
    """

    def between(common: Float[np.ndarray, "m 6 e"]) -> float:
        positions = common[:, :3]
        return float(np.sqrt(np.sum((positions - positions.mean(axis=0)) ** 2) / len(positions)))

    without_scale = [source != PRINT_SCALE for source in marginal.sources]
    return between(marginal.of_camera), between(marginal.common[:, :, without_scale])


def unstated_scale_warnings(
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
            "State the target's certificate or pitch_standard_uncertainty_mm (`gridpose targets change`).",
        )
    ]


def _shape_warnings(dominated: Sequence[tuple[str, float, float]]) -> list[Advisory]:
    if not dominated:
        return []
    found = "; ".join(
        f"{both:.2g} mm with it, {camera:.2g} mm by the camera alone in focus group {name!r}"
        for name, camera, both in dominated
    )
    return [
        Advisory(
            SHAPE_DOMINATES,
            "What the shape of the print leaves open makes positions between poses more uncertain than the camera "
            f"does: {found} (standard uncertainties).",
            "Add four views of the target tilted by 20° to 40° to different sides, as poses near the others, in every "
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
