"""Camera poses of every image of a focus group, by one of five estimators on the same grid points.

- `pooled`: all images share one camera; the default, since repeatability needs constant intrinsics, not correct ones.
- `pooled_free_focal`: all but the focal length is shared, for a lens that refocuses between images.
- `per_image`: every image by itself, with weak priors (`single_image`).
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
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.multi_view.correlated_residuals import VarianceInflation
from core.calibration.multi_view.covariance import MultiViewCovariance, multi_view_covariance
from core.calibration.multi_view.initialisation import Fitted, fit_with_known_camera
from core.calibration.multi_view.per_image import fit_each
from core.calibration.multi_view.planar_ambiguity import compare_solutions, pose_ambiguity_failure
from core.calibration.multi_view.pooled import fit_pooled
from core.calibration.multi_view.repeat_consistency import with_common_points, with_pooled_variances
from core.calibration.multi_view.view_stack import Placements, ViewStack, number_labels, stack_views
from core.calibration.state import SMALLEST_NOISE_PX, Lens
from core.errors import Advisory, GridposeError, InvalidArgument
from core.geometry import AnyCamera, Camera, camera_from_array
from core.targets import GridPoints

NOTABLE_INFLATION = 1.5
CERTAIN_EVIDENCE = 20.0
"""Standard deviations between a tilt and its opposite beyond which no single image's noise makes it ambiguous."""
ESTIMATORS = ("pooled", "pooled_free_focal", "per_image", "per_image_fixed_pp", "given")


@dataclass(frozen=True, slots=True)
class CommonFit:
    """The fit of one camera to k images, from which another model of their poses can continue.

    `views` are the grid points as they were fitted, `used` those that were not rejected, `placements` the camera and
    the poses, `pose` numbers the robot's poses that the images show. `scale` is the noise per unit of stated
    uncertainty, `growth` that of `GroupEstimate.inflation`; `lens` is the prior, None where the images contradict it.
    """

    views: ViewStack
    used: Bool[np.ndarray, " n"]
    placements: Placements
    pose: Int[np.ndarray, " k"]
    scale: float
    growth: VarianceInflation
    lens: Lens | None

    def take(self, images: Int[np.ndarray, " j"]) -> CommonFit:
        """Return some of the images, in ascending order."""
        points = self.views.spread(np.isin(np.arange(len(self.views)), images))
        return replace(
            self,
            views=self.views.take(images),
            used=self.used[points],
            placements=self.placements.take(images),
            pose=self.pose[images],
        )


@dataclass(frozen=True, slots=True)
class GroupEstimate:
    """Cameras and poses of one focus group; arrays run over the k images that were estimated.

    Parameters
    ----------
    images
        Which of the views given they are, ascending; the others are in `failures`, with the reason.
    camera, camera_covariance
        The common camera, or with estimators that have none the mean over the images with the mean covariance (what
        priors leave of an image's uncertainty does not average out); order of its model's `LENS_PARAMETERS`.
    positions_mm, rotations
        The camera in the target frame.
    covariance, scatter
        x, y, z (mm), then a small rotation w with R_true = exp(w) R, in the target frame; see the module.
    common
        What one standard uncertainty of each error that all images share does to their poses: as many of the shared
        camera as it has free parameters (eight with Brown's lens model), one of the print's scale. `covariance` is
        the image's own and common commonᵀ.
    reduced_chi2
        Squared residuals over the points' stated uncertainties, per degree of freedom.
    disagreement
        How much better the images would be explained if each had a camera of its own, over what chance would make of
        it: 1 where one camera explains all. None where nothing is shared or there is one image only.
    unsteady
        Of each image, whether the camera changed among the images of its pose, by so much that it shows in their
        scatter. What print and lens model lack is the same in all of them and is no such change.
    differing
        Of each image, whether the images of its pose show so different points that they had to be estimated from other
        points each (`repeat_consistency`): then systematic errors add to their scatter.
    image_p_values
        Chance of each image's fine residuals and of their pattern, if it were as the others of its pose.
    warnings
        What to know of the whole group.
    inflation
        By how much the uncertainties of the camera are larger than independent residuals would leave them; those of
        poses grow with them, `scatter` does not (`systematic`).
    fit
        What `pooled` fitted; None with other estimators.
    misfit
        Variance of the residuals over that of the noise which repeats show: 1 where the model fits.
    """

    estimator: str
    images: Int[np.ndarray, " k"]
    failures: tuple[tuple[int, GridposeError], ...]
    camera: AnyCamera
    camera_covariance: Float[np.ndarray, "s s"]
    cameras: Float[np.ndarray, "k s"]
    positions_mm: Float[np.ndarray, "k 3"]
    rotations: Float[np.ndarray, "k 3 3"]
    covariance: Float[np.ndarray, "k 6 6"]
    scatter: Float[np.ndarray, "k 6 6"]
    common: Float[np.ndarray, "k 6 e"]
    rms_px: Float[np.ndarray, " k"]
    reduced_chi2: float
    disagreement: float | None
    unsteady: Bool[np.ndarray, " k"]
    differing: Bool[np.ndarray, " k"]
    image_p_values: Float[np.ndarray, "k 2"]
    warnings: tuple[Advisory, ...] = ()
    inflation: float = 1.0
    fit: CommonFit | None = None
    misfit: float = 1.0


def estimate_group(
    views: Sequence[GridPoints] | ViewStack,
    estimator: str,
    *,
    lens: Lens | None = None,
    intrinsics: Camera | None = None,
    repeats: Sequence[Hashable] | None = None,
    lens_start: AnyCamera | None = None,
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
        A camera near the one sought, whose lens model pooled estimators then take; None is Brown's, from any start.

    Raises InvalidArgument for no views, mixed image sizes, an unknown estimator or `given` without intrinsics;
    EstimationError where no view can be estimated or, with a shared camera, the focal length is not determined.
    """
    stack = views if isinstance(views, ViewStack) else stack_views(views)
    labels = number_labels(range(len(stack)) if repeats is None else repeats)
    stack, differing = with_common_points(stack, labels)
    stack = with_pooled_variances(stack, labels)
    failures: dict[int, GridposeError] = {}
    if estimator in ("pooled", "pooled_free_focal"):
        fitted = fit_pooled(stack, labels, estimator, lens, failures, lens_start)
    elif estimator == "given":
        if intrinsics is None:
            raise InvalidArgument("The estimator `given` needs intrinsics.")
        fitted = fit_with_known_camera(stack, labels, intrinsics, failures)
    elif estimator in ("per_image", "per_image_fixed_pp"):
        fitted = fit_each(stack, labels, estimator, lens, intrinsics, failures)
    else:
        raise InvalidArgument(f"Unknown estimator {estimator!r}.", f"Use one of {', '.join(ESTIMATORS)}.")
    uncertainty = multi_view_covariance(fitted)
    estimate = _with_covariance(fitted, uncertainty, failures, differing)
    return _without_ambiguous(estimate, fitted, uncertainty)


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
    )


def _common_fit(fitted: Fitted, growth: VarianceInflation) -> CommonFit | None:
    if fitted.estimator != "pooled" or fitted.shared is None:
        return None
    scale = max(fitted.shared.scale, SMALLEST_NOISE_PX / float(fitted.views.uncertainty.mean()))
    return CommonFit(
        fitted.views, fitted.used, fitted.at.placements, fitted.labels, scale, growth, fitted.lens
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
