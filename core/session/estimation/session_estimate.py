"""Estimation of the camera's pose in every image from grid points, for each focus group."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool

from core.calibration import GroupEstimate
from core.errors import (
    Advisory,
    GridposeError,
    IntrinsicsMissing,
    MixedImageSizes,
    TooFewMeasurements,
    TooManyMeasurements,
    listed,
)
from core.geometry import LensModel
from core.session.estimate import (
    TURNED_ADVICE,
    ExcludedMeasurement,
    FocusGroup,
    SessionEstimate,
    exclusion_warnings,
    in_order,
)
from core.session.estimation.agreement import disagreement
from core.session.estimation.board_symmetry import LabelledGroup, label_poses, label_repeats
from core.session.estimation.lens_model import check_asked, estimate_with_lens, lens_warnings, of_one_width
from core.session.estimation.other_setting import with_setting_warning
from core.session.estimation.refusal import refusal_of_all
from core.session.model import CameraViews, ImageObservation, MeasuredPose, SessionData, natural

MAX_POINTS = 4_000_000
"""Grid points of one analysis, which takes some 450 bytes for each."""
_UNCLEAR = (
    "The image shows another orientation than the first of its pose, however the symmetric board is labelled."
)


def estimate_session(
    data: SessionData, estimator: str = "pooled", lens_model: LensModel | None = None, *, weak: bool = False
) -> SessionEstimate:
    """Estimate the camera of every focus group and its pose in every image.

    Parameters
    ----------
    data
        The session's images with their grid points.
    estimator
        One of `core.calibration.multi_view.estimators.ESTIMATORS`.
    lens_model
        Of the pooled estimators; None is Brown's unless the images contradict it.
    weak
        Whether cameras that determine the focal length weakly are an answer (`core.calibration.estimate_group`), as
        cameras and their poses are; figures of a robot are not made of them.

    Raises TooFewMeasurements, TooManyMeasurements, IntrinsicsMissing, MixedImageSizes, InvalidArgument for a lens model
    that the estimator does not take, and where not a single image can be estimated the failure that most of them
    share, or NothingUsable.
    """
    _check(data, estimator)
    check_asked(estimator, lens_model)
    excluded: dict[str, ExcludedMeasurement] = {}
    observed = data.observed()
    for i, image in enumerate(data.images):
        if i not in observed:
            _exclude(excluded, image, image.failure_code or "no_points", image.failure_detail or "No points.")
    warnings: list[Advisory] = []
    failures: list[GridposeError] = []
    labelled: list[LabelledGroup] = []
    for name in sorted({group.focus_group for group in data.views}):
        views = _of_one_size(name, data, excluded, warnings)
        try:
            labelled.append(_estimate(views, data, estimator, excluded, lens_model, weak))
        except GridposeError as failure:
            failures.append(failure)
            for i in views.images.tolist():
                if data.images[i].measurement_id not in excluded:
                    _exclude(excluded, data.images[i], failure.code, failure.detail)
    if not labelled:
        raise _nothing(data, excluded, failures)
    labelling = label_poses(data, labelled)
    groups = of_one_width(tuple(_focus_group(data, group) for group in labelling.groups))
    disagreements = {group.name: disagreement(group) for group in groups}
    warnings += [
        warning
        for group in groups
        for warning in group.estimate.warnings
        if not (warning.code == "residuals_correlated" and disagreements[group.name])  # which says more
    ]
    warnings += [warning for warning in disagreements.values() if warning is not None]
    warnings += [warning for group in groups for warning in lens_warnings(group)]
    unsteady = frozenset(p for group in groups for p in _poses_where(group, group.estimate.unsteady))
    differing = frozenset(p for group in groups for p in _poses_where(group, group.estimate.differing))
    if unsteady:
        warnings.append(_unsteady_warning(unsteady))
    if differing:
        warnings.append(_differing_warning(differing))
    return SessionEstimate(
        estimator,
        groups,
        in_order(data, groups),
        excluded,
        (*warnings, *labelling.warnings, *exclusion_warnings(data, excluded)),
        {
            one: ExcludedMeasurement(one, "orientation_inconsistent", _UNCLEAR)
            for one in sorted(labelling.unclear)
        },
        unsteady,
        differing,
    )


def measured_poses(images: Sequence[ImageObservation], estimate: GroupEstimate) -> tuple[MeasuredPose, ...]:
    """Return an estimate's rows, one for each of the images, as poses."""
    return tuple(
        MeasuredPose(
            image.measurement_id,
            image.pose_id,
            image.cycle,
            image.joint_angles_deg,
            position_mm,
            rotation,
            covariance,
            scatter,
            common,
            image.target,
            image,
            rms_px,
        )
        for image, position_mm, rotation, covariance, scatter, common, rms_px in zip(
            images,
            estimate.positions_mm,
            estimate.rotations,
            estimate.covariance,
            estimate.scatter,
            estimate.common,
            estimate.rms_px.tolist(),
            strict=True,
        )
    )


def _focus_group(data: SessionData, group: LabelledGroup) -> FocusGroup:
    images = [data.images[i] for i in group.images.tolist()]
    poses = measured_poses(images, group.estimate)
    return FocusGroup(group.name, group.estimate, poses, group.views, group.quarters, group.evidence)


def _check(data: SessionData, estimator: str) -> None:
    if not data.images:
        if data.pending:
            raise TooFewMeasurements(
                f"None of the session's images is measured yet; {data.pending} are waiting.",
                "Ask again when the session's queued and running counts are lower.",
            )
        if data.measured or data.measured_instead:
            raise TooFewMeasurements(
                "The session has no images; it has poses that another instrument measured.",
                "Analyses of a robot take those with source=measured_poses (--source measured_poses); those of a "
                "camera need images.",
            )
        raise TooFewMeasurements("The session has no images.")
    if estimator == "given" and data.intrinsics is None:
        raise IntrinsicsMissing(
            "The estimator `given` takes the session's intrinsics, and the session has none."
        )
    if data.points_count() > MAX_POINTS:
        raise TooManyMeasurements(
            f"The session's images hold {data.points_count()} grid points; one analysis takes {MAX_POINTS}."
        )


def _exclude(
    excluded: dict[str, ExcludedMeasurement], image: ImageObservation, code: str, detail: str
) -> None:
    excluded[image.measurement_id] = ExcludedMeasurement(image.measurement_id, code, detail)


def _of_one_size(
    name: str, data: SessionData, excluded: dict[str, ExcludedMeasurement], warnings: list[Advisory]
) -> CameraViews:
    """Return the images of the size that most have; a group without such a size cannot share a camera."""
    groups = [group for group in data.views if group.focus_group == name]
    if len(groups) == 1:
        return groups[0]
    sizes = {(g.views.image_width_px, g.views.image_height_px): g for g in groups}
    (width, height), most = max(sizes.items(), key=lambda item: (len(item[1].images), item[0]))
    found = ", ".join(
        f"{w} x {h} ({len(g.images)})" for (w, h), g in sorted(sizes.items(), key=lambda i: i[0])
    )
    if 2 * len(most.images) <= sum(len(g.images) for g in groups):
        raise MixedImageSizes(
            f"The images of focus group {name!r} have several sizes, none of them most images': {found}."
        )
    for image in (data.images[i] for g in groups if g is not most for i in g.images.tolist()):
        detail = f"The image has {image.width_px} x {image.height_px} px, its focus group {width} x {height}."
        _exclude(excluded, image, "image_size_differs", detail)
    warnings.append(
        Advisory(
            "image_size_differs",
            f"The images of focus group {name!r} have several sizes: {found}. Those of {width} x {height} px "
            "are used.",
            f"Give each camera setting a focus_group of its own. {TURNED_ADVICE}",
        )
    )
    return most


def _estimate(
    group: CameraViews,
    data: SessionData,
    estimator: str,
    excluded: dict[str, ExcludedMeasurement],
    lens_model: LensModel | None,
    weak: bool,
) -> LabelledGroup:
    images = [data.images[i] for i in group.images.tolist()]
    views, quarters, shows_origin = label_repeats(group, data.images)
    repeats = [(image.pose_id, image.target) for image in images]
    estimate, evidence = estimate_with_lens(
        group.focus_group, views, data, estimator, repeats, lens_model, weak=weak
    )
    for i, failure in estimate.failures:
        _exclude(excluded, images[i], failure.code, failure.detail)
    estimate = with_setting_warning(group.focus_group, views, images, repeats, estimate, data)
    rows = estimate.images
    shown = views.take(rows)
    return LabelledGroup(
        group.focus_group, group.images[rows], shows_origin[rows], estimate, shown, quarters[rows], evidence
    )


def _nothing(
    data: SessionData, excluded: Mapping[str, ExcludedMeasurement], failures: list[GridposeError]
) -> GridposeError:
    reasons = Counter(exclusion.code for exclusion in excluded.values())
    if len({failure.code for failure in failures}) == 1 and 2 * reasons[failures[0].code] >= len(data.images):
        return failures[0]
    return refusal_of_all(len(data.images), reasons)


def _poses_where(group: FocusGroup, found: Bool[np.ndarray, " k"]) -> set[str]:
    return {pose.pose_id for pose, one in zip(group.poses, found.tolist(), strict=True) if one}


def _unsteady_warning(poses: frozenset[str]) -> Advisory:
    return Advisory(
        "intrinsics_drift",
        f"The camera was not the same in all images of {len(poses)} poses: {listed(sorted(poses, key=natural))}. Their "
        "scatter is not the robot's alone, and no figure of theirs is said to be.",
        "Switch automatic focus, zoom and image stabilisation off; or use estimator=pooled_free_focal where the lens "
        "refocuses between images.",
    )


def _differing_warning(poses: frozenset[str]) -> Advisory:
    return Advisory(
        "repeats_inconsistent",
        f"The images of {len(poses)} poses show so different grid points that less than half of them are common: "
        f"{listed(sorted(poses, key=natural))}. A print that is not flat or a lens beyond its model moves such images "
        "against one another, and no figure of these poses is said to be the robot's.",
        "Keep the same part of the board in view in all cycles of a pose; exclude images in which much is hidden.",
    )
