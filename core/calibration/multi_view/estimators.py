"""Camera poses of every image of a focus group, by one of six estimators on the same grid points.

- `pooled`: all images share one camera; the default, since repeatability needs constant intrinsics, not correct ones.
- `pooled_free_focal`: all but the focal length is shared, for a lens that refocuses between images.
- `per_image`: every image by itself, with weak priors (`single_image`).
- `per_image_session_prior`: every image by itself, with the lens of the other images as its prior.
- `per_image_fixed_pp`: every image by itself with the principal point held (`fixed_principal_point`).
- `given`: the camera is known.

Two covariances come with every pose. `covariance` is that of the pose itself. `scatter` is that of the differences
between images of one pose taken by a camera at rest: what is common to the images (the shared camera, what priors pull
all images to, the print's scale) is not in it. Its noise scale comes from the residuals of images of one pose about
their mean where there are such images: what a bowed print or a lens beyond the model leaves in
them is the same in all, makes no scatter, and must not be taken for noise. It may cost a point its place, then in all
images of the pose (`repeat_consistency`).
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.multi_view.correlated_residuals import VarianceInflation
from core.calibration.multi_view.covariance import MultiViewCovariance, multi_view_covariance
from core.calibration.multi_view.fitting import Fitted, fit_pooled, fit_with_known_camera
from core.calibration.multi_view.group_estimate import CommonFit, GroupEstimate
from core.calibration.multi_view.planar_ambiguity import compare_solutions, pose_ambiguity_failure
from core.calibration.multi_view.repeat_consistency import with_common_points, with_pooled_variances
from core.calibration.multi_view.separate_cameras import fit_each
from core.calibration.multi_view.view_stack import ViewStack, number_labels, stack_views
from core.calibration.priors import Lens
from core.calibration.result import MAX_DETERMINED_UNCERTAINTY, focal_weakly_observable
from core.calibration.state import SMALLEST_NOISE_PX
from core.errors import ADVISED_TILT, Advisory, GridposeError, InvalidArgument
from core.geometry import AnyCamera, Camera, camera_from_array
from core.targets import GridPoints

NOTABLE_INFLATION = 1.5
CERTAIN_EVIDENCE = 20.0
"""Standard deviations between a tilt and its opposite beyond which no single image's noise makes it ambiguous."""
SEPARATE_CAMERAS = ("per_image", "per_image_session_prior", "per_image_fixed_pp")
POOLED = ("pooled", "pooled_free_focal")
ESTIMATORS = (*POOLED, *SEPARATE_CAMERAS, "given")


def estimate_group(
    views: Sequence[GridPoints] | ViewStack,
    estimator: str,
    *,
    lens: Lens | None = None,
    intrinsics: Camera | None = None,
    repeats: Sequence[Hashable] | None = None,
    lens_start: AnyCamera | None = None,
    weak: bool = False,
) -> GroupEstimate:
    """Estimate the camera's pose in every view.

    Parameters
    ----------
    views
        Images of one size, taken with one setting of lens and camera.
    lens
        A 5 % prior on the focal length.
    intrinsics
        The camera of `given`; its principal point is the one held by `per_image_fixed_pp`.
    repeats
        A label for each view: views with the same one show the same pose of the robot.
    lens_start
        A camera near the one sought, whose lens model `pooled`, `pooled_free_focal` and `per_image_session_prior`
        take; None is Brown's, from any start.
    weak
        Whether a camera with a u(f)/f above 2 % is an answer, up to that of `MAX_FOCAL_UNCERTAINTY`. Poses scatter by
        u(f) along the line of sight where each image has a camera of its own: no figure of a robot is made of them.

    Raises InvalidArgument for no views, mixed image sizes, an unknown estimator or `given` without intrinsics;
    EstimationError where no view can be estimated or, with a shared camera, the focal length is not determined.
    """
    stack = views if isinstance(views, ViewStack) else stack_views(views)
    labels = number_labels(range(len(stack)) if repeats is None else repeats)
    stack, differing = with_common_points(stack, labels)
    stack = with_pooled_variances(stack, labels)
    failures: dict[int, GridposeError] = {}
    if estimator in POOLED:
        fitted = fit_pooled(stack, labels, estimator, lens, failures, lens_start, weak=weak)
    elif estimator == "given":
        if intrinsics is None:
            raise InvalidArgument("The estimator `given` needs intrinsics.")
        fitted = fit_with_known_camera(stack, labels, intrinsics, failures)
    elif estimator in SEPARATE_CAMERAS:
        fitted = fit_each(stack, labels, estimator, lens, intrinsics, failures, lens_start, weak=weak)
    else:
        raise InvalidArgument(f"Unknown estimator {estimator!r}.", f"Use one of {', '.join(ESTIMATORS)}.")
    uncertainty = multi_view_covariance(fitted)
    estimate = _with_covariance(fitted, uncertainty, failures, differing)
    if estimator in POOLED:
        estimate = _graded(estimate)
    return _without_ambiguous(estimate, fitted, uncertainty)


def _graded(estimate: GroupEstimate) -> GroupEstimate:
    """Return the estimate with a warning where its focal length, by all that is uncertain of it, is weakly determined:
    under a lens model that is not the lens's, by far more than the fit's own noise leaves.
    """
    u = estimate.focal_relative_uncertainty
    if u <= MAX_DETERMINED_UNCERTAINTY:
        return estimate
    warning = focal_weakly_observable(
        "Together the images leave",
        u,
        f"Add images with the target tilted by {ADVISED_TILT}, or state the session's lens or its intrinsics.",
    )
    return replace(estimate, warnings=(warning, *estimate.warnings))


def _without_ambiguous(
    estimate: GroupEstimate, fitted: Fitted, uncertainty: MultiViewCovariance
) -> GroupEstimate:
    """Return the estimate without images of poses whose tilt is ambiguous; the camera stays estimated with them.

    Raises PoseAmbiguous where these are all.
    """
    at, views = fitted.at, fitted.views
    points = views.sums(fitted.used.astype(np.float64))
    scale = np.sqrt(at.square_sums / np.maximum(2.0 * points - 6.0, 1.0))
    # Errors common to neighbouring residuals or to the images of a pose carry less information than independent noise.
    growth = max(uncertainty.growth.own, uncertainty.growth.camera)
    certain = None
    if fitted.tilt_evidence is not None and fitted.shared is not None:
        # Most poses are so sure at the fit's own scale that no look at the image's own changes it.
        larger = math.sqrt(growth) * float(np.max(scale)) / fitted.shared.scale
        certain = fitted.tilt_evidence > CERTAIN_EVIDENCE * max(larger, 1.0)
    tilts = compare_solutions(
        views,
        fitted.labels,
        at.placements,
        at.residuals,
        fitted.used,
        growth * np.maximum(scale, SMALLEST_NOISE_PX / views.uncertainty) ** 2,
        at.of_poses,
        certain,
    )
    wrong = tilts.ambiguous | tilts.changed
    if not wrong.any():
        return estimate
    failures = dict(estimate.failures)
    for k in np.flatnonzero(wrong).tolist():
        failures[int(estimate.images[k])] = pose_ambiguity_failure(
            float(tilts.ratio[k]), at.placements.view(k)
        )
    if wrong.all():
        raise failures[int(estimate.images[0])]
    rest = ~wrong
    return replace(
        estimate,
        images=estimate.images[rest],
        failures=tuple(sorted(failures.items())),
        cameras=estimate.cameras[rest],
        positions_mm=estimate.positions_mm[rest],
        rotations=estimate.rotations[rest],
        covariance=estimate.covariance[rest],
        scatter=estimate.scatter[rest],
        common=estimate.common[rest],
        rms_px=estimate.rms_px[rest],
        unsteady=estimate.unsteady[rest],
        differing=estimate.differing[rest],
        image_p_values=estimate.image_p_values[rest],
        focal_uncertainty=None if estimate.focal_uncertainty is None else estimate.focal_uncertainty[rest],
        fit=None if estimate.fit is None else estimate.fit.take(np.flatnonzero(rest)),
    )


def _with_covariance(
    fitted: Fitted,
    uncertainty: MultiViewCovariance,
    failures: dict[int, GridposeError],
    differing: Bool[np.ndarray, " m"],
) -> GroupEstimate:
    placements = fitted.at.placements
    growth = (
        uncertainty.growth.own
        if fitted.shared is None or fitted.estimator == "given"
        else uncertainty.growth.camera
    )
    inflation = math.sqrt(growth)
    return GroupEstimate(
        estimator=fitted.estimator,
        images=np.array(fitted.images),
        failures=tuple(sorted(failures.items())),
        camera=camera_from_array(_mean_camera(placements.parameters)),
        camera_covariance=uncertainty.camera_covariance,
        cameras=placements.parameters,
        positions_mm=uncertainty.positions_mm,
        rotations=np.ascontiguousarray(np.swapaxes(placements.rotations, 1, 2)),
        covariance=uncertainty.covariance,
        scatter=uncertainty.scatter,
        common=uncertainty.common,
        rms_px=uncertainty.rms_px,
        reduced_chi2=uncertainty.reduced_chi2,
        disagreement=uncertainty.disagreement,
        unsteady=uncertainty.unsteady,
        differing=differing[fitted.images],
        image_p_values=uncertainty.image_p_values,
        warnings=fitted.warnings + _warnings(inflation),
        inflation=inflation,
        fit=_common_fit(fitted, uncertainty.growth),
        misfit=uncertainty.misfit,
        focal_uncertainty=uncertainty.focal_uncertainty,
    )


def _common_fit(fitted: Fitted, growth: VarianceInflation) -> CommonFit | None:
    if fitted.estimator != "pooled" or fitted.shared is None:
        return None
    scale = max(fitted.shared.scale, SMALLEST_NOISE_PX / float(fitted.views.uncertainty.mean()))
    at = fitted.at
    return CommonFit(
        fitted.views, fitted.used, at.placements, at.residuals, fitted.labels, scale, growth, fitted.lens
    )


def _warnings(inflation: float) -> tuple[Advisory, ...]:
    if inflation <= NOTABLE_INFLATION:
        return ()
    return (
        Advisory(
            "residuals_correlated",
            "Residuals agree between neighbouring points, between images of a pose, or differ from pose to pose as "
            "noise does not: the grid or the lens departs from the model. Uncertainties of the camera and of absolute "
            f"poses are scaled up by {inflation:.1f}; the noise floor of repeatability does not contain what is common "
            "to the images.",
            "Check that the grid is flat and true to size; tilted views from many sides average such errors out.",
        ),
    )


def _mean_camera(cameras: Float[np.ndarray, "k s"]) -> Float[np.ndarray, " s"]:
    """Return the mean over the images; to the last bit what all have in common."""
    common = np.all(cameras == cameras[0], axis=0)
    return np.where(common, cameras[0], cameras.mean(axis=0))
