"""The targets of a session: the transforms between them, and the measured shape of one of them.

The shape is estimated from one focus group's images of one target, those of which there are most, and then taken for
every image of that target. The uncertainty that the shape adds to the camera is added to the covariance of that
group's.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float

from core.calibration import (
    ShapePrior,
    TargetShape,
    ViewStack,
    estimate_group,
    estimate_target_shape,
    evenly,
    stack_views,
)
from core.errors import Advisory
from core.geometry import hat, transform, transform_mean
from core.kinematics import TargetTransform
from core.session.estimate import FocusGroup, SessionEstimate, in_order
from core.session.estimation.lens_model import is_brown, of_one_width
from core.session.estimation.session_estimate import measured_poses
from core.session.model import MeasuredPose, SessionData
from core.targets import ShapeUncertainty

MAX_IMAGES = 120
"""Of which a shape is estimated; more are thinned evenly, since images of one pose carry the same information."""


@dataclass(frozen=True, slots=True)
class RefinedTarget:
    """The shape of one target, from `images` images of a focus group; and the session before that target.

    `estimate` is the session's as it was where the shape does not differ from the nominal one (`applied` False).
    """

    target: int
    focus_group: str
    images: int
    shape: TargetShape
    applied: bool
    estimate: SessionEstimate

    @property
    def shapes(self) -> Mapping[int, ShapePrior]:
        """What is left open of the target's shape, for absolute figures; nothing where it was not applied."""
        return self.estimate.shapes


def refine_target(data: SessionData, estimate: SessionEstimate) -> RefinedTarget:
    """Estimate the shape of the target that most images show, and the cameras again with it.

    Raises TargetShapeNotObservable where the images do not determine it.
    """
    counts = Counter((pose.frame, group.name) for group in estimate.groups for pose in group.poses)
    target, name = min(counts, key=lambda key: (-counts[key], key))
    group = next(g for g in estimate.groups if g.name == name)
    # Images are in the order of their poses.
    chosen = evenly([k for k, pose in enumerate(group.poses) if pose.frame == target], MAX_IMAGES)
    start = None if is_brown(group) else group.estimate.camera
    shape = estimate_target_shape([group.views.view(k) for k in chosen], lens=data.lens, start=start)
    applied = shape.in_plane.significant or shape.out_of_plane.significant
    warnings: list[Advisory] = []
    if len(data.targets) > 1:
        warnings.append(
            Advisory(
                "only_one_target_refined",
                f"The shape of target {data.target_ids[target]} was estimated, which most images show; the others are "
                "taken as perfect.",
                "Put images of each target into a session of their own to refine it.",
            )
        )
    if applied:
        groups = of_one_width(tuple(_again(data, old, shape, target, name) for old in estimate.groups))
        warnings += _applied_warnings(estimate.groups, groups, name)
        shapes = {target: _left_open(shape)}
        estimate = replace(estimate, groups=groups, poses=in_order(data, groups), shapes=shapes)
    estimate = replace(estimate, warnings=(*estimate.warnings, *warnings))
    return RefinedTarget(target, name, len(chosen), shape, applied, estimate)


def _left_open(shape: TargetShape) -> ShapePrior:
    sigma, target = shape.standard_uncertainty_mm, shape.target
    in_plane = math.sqrt(float(np.mean(sigma[:, :2] ** 2)))
    left = ShapeUncertainty(
        shape.aspect.standard_uncertainty,
        shape.shear.standard_uncertainty,
        max(shape.bow_x_mm.standard_uncertainty, shape.bow_y_mm.standard_uncertainty),
        shape.twist_mm.standard_uncertainty,
        in_plane,
        in_plane,
    )
    return ShapePrior(left, target.scale_standard_uncertainty, target.certificate is not None)


def _applied_warnings(
    before: tuple[FocusGroup, ...], after: tuple[FocusGroup, ...], name: str
) -> list[Advisory]:
    warnings = []
    others = [g.name for g in after if g.name != name]
    if others:
        warnings.append(
            Advisory(
                "target_shape_uncertainty_ignored",
                f"The shape comes from focus group {name!r}; the uncertainties of {', '.join(map(repr, others))} do "
                "not hold what it leaves open.",
                "Put the images of each camera setting into a session of their own.",
            )
        )
    lost = sum(len(old.poses) - len(new.poses) for old, new in zip(before, after, strict=True))
    if lost:
        warnings.append(
            Advisory(
                "images_excluded_from_refinement",
                f"{lost} images could not be estimated again before the refined target, and are not in its figures.",
                "Look at the overlays of the worst images.",
            )
        )
    return warnings


def _again(data: SessionData, old: FocusGroup, shape: TargetShape, target: int, name: str) -> FocusGroup:
    """Estimate a group's camera and poses again, with the target's shape; as it was where no image shows the target.

    What the shape leaves open of the camera is added to the covariance of the group that it comes from.
    """
    if all(pose.frame != target for pose in old.poses):
        return old
    views = _on_shape(old, shape, target)
    estimate = estimate_group(
        views,
        old.estimate.estimator,
        lens=data.lens,
        intrinsics=data.intrinsics,
        repeats=[(pose.pose_id, pose.frame) for pose in old.poses],
        lens_start=None if is_brown(old) else old.estimate.camera,
    )
    if estimate.estimator != "given" and old.name == name:
        estimate = replace(estimate, camera_covariance=estimate.camera_covariance + shape.shape_covariance)
    rows = estimate.images
    images = [pose.image for pose in old.poses if pose.image is not None]
    return FocusGroup(
        old.name,
        estimate,
        measured_poses([images[i] for i in rows.tolist()], estimate),
        views.take(rows),
        old.quarters[rows],
        old.evidence,
    )


def _on_shape(old: FocusGroup, shape: TargetShape, target: int) -> ViewStack:
    """Return the group's views with the target's points where its shape has them; another print of the same
    description keeps its own.
    """
    prints = [pose.frame for pose in old.poses]
    views = [old.views.view(k) for k in range(len(prints))]
    return stack_views(
        [shape.applied(view) if shown == target else view for view, shown in zip(views, prints, strict=True)],
        prints,
    )


def target_transforms(data: SessionData, estimate: SessionEstimate) -> list[TargetTransform]:
    """Return T_from_to of every two targets that some images show together; `poses` is the number of these images."""
    shown: dict[tuple[str, str], dict[int, MeasuredPose]] = {}
    for pose in estimate.poses:
        if pose.image is not None:
            shown.setdefault((pose.pose_id, pose.image.image), {})[pose.frame] = pose
    found = []
    for first, second in combinations(range(len(data.targets)), 2):
        pairs = [(both[first], both[second]) for both in shown.values() if first in both and second in both]
        if pairs:
            mean = transform_mean(np.array([_relative(a, b) for a, b in pairs]))
            found.append(TargetTransform(first, second, mean, _relative_covariance(pairs), len(pairs)))
    return found


def _relative(a: MeasuredPose, b: MeasuredPose) -> Float[np.ndarray, "4 4"]:
    """Return T_a_b = T_a_camera T_camera_b."""
    rotation = _relative_rotation(a, b)
    return transform(rotation, a.position_mm - rotation @ b.position_mm)


def _relative_covariance(pairs: Sequence[tuple[MeasuredPose, MeasuredPose]]) -> Float[np.ndarray, "6 6"]:
    """Propagate covariances of the poses of both targets in each image to the mean transform.

    What an image has of its own is averaged over the poses: images of one pose may have the same departure. Errors of
    the lens and of the prints' shape are common to all images of a focus group, and move both poses of an image
    together; those of two prints' scale are independent.
    """
    own = np.zeros((6, 6))
    shared: dict[str, list[Float[np.ndarray, "6 e"]]] = {}
    for a, b in pairs:
        assert a.image is not None  # poses of images have one, and errors that they share
        assert a.common is not None
        assert b.common is not None
        J = _relative_effects(a, b)
        both = np.zeros((12, 12))
        both[:6, :6], both[6:, 6:] = a.own_covariance(), b.own_covariance()
        own += J @ both @ J.T
        none = np.zeros((6, 1))
        errors = [[a.common, none], [b.common[:, :-1], none, b.common[:, -1:]]]
        shared.setdefault(a.image.focus_group, []).append(J @ np.block(errors))
    found = own / len(pairs) / len({a.pose_id for a, _ in pairs})
    for of_group in shared.values():
        mean = np.mean(of_group, axis=0)
        found += len(of_group) / len(pairs) * mean @ mean.T
    return np.asarray(0.5 * (found + found.T))


def _relative_effects(a: MeasuredPose, b: MeasuredPose) -> Float[np.ndarray, "6 12"]:
    """Return what small motions of both poses do: w = w_a - R w_b, d = d_a - R d_b + [R p_b]× w, with R = R_a R_bᵀ."""
    rotation = _relative_rotation(a, b)
    arm = hat(rotation @ b.position_mm)
    J = np.zeros((6, 12))
    J[:3, :3] = J[3:, 3:6] = np.eye(3)
    J[:3, 6:9] = J[3:, 9:] = -rotation
    J[:3, 3:6], J[:3, 9:] = arm, -arm @ rotation
    return J


def _relative_rotation(a: MeasuredPose, b: MeasuredPose) -> Float[np.ndarray, "3 3"]:
    assert a.rotation is not None  # poses of images have one
    assert b.rotation is not None
    return np.asarray(a.rotation @ b.rotation.T)
