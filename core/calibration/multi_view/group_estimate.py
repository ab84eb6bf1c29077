"""What is estimated of a focus group, as values: its camera, and the pose of every image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.multi_view.correlated_residuals import VarianceInflation
from core.calibration.multi_view.view_stack import Placements, ViewStack
from core.calibration.priors import Lens
from core.calibration.result import focal_relative_uncertainty
from core.errors import Advisory, GridposeError
from core.geometry import AnyCamera


@dataclass(frozen=True, slots=True)
class CommonFit:
    """The fit of one camera to k images, from which another model of their poses can continue.

    `views` are the grid points as they were fitted, `used` those that were not rejected, `placements` the camera and
    the poses, `residuals` (px) those of all points there, `pose` numbers the robot's poses that the images show.
    `scale` is the noise per unit of stated uncertainty, `growth` that of `GroupEstimate.inflation`; `lens` is the
    prior, None where the images contradict it.
    """

    views: ViewStack
    used: Bool[np.ndarray, " n"]
    placements: Placements
    residuals: Float[np.ndarray, "2 n"]
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
            residuals=self.residuals[:, points],
            pose=self.pose[images],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseUncertainties:
    """Positions of the camera in the target frame, and what is uncertain of camera and poses; see `GroupEstimate`."""

    camera_covariance: Float[np.ndarray, "s s"]
    positions_mm: Float[np.ndarray, "k 3"]
    covariance: Float[np.ndarray, "k 6 6"]
    scatter: Float[np.ndarray, "k 6 6"]
    common: Float[np.ndarray, "k 6 e"]
    rms_px: Float[np.ndarray, " k"]
    reduced_chi2: float
    disagreement: float | None
    unsteady: Bool[np.ndarray, " k"]
    image_p_values: Float[np.ndarray, "k 2"]
    misfit: float = 1.0
    focal_uncertainty: Float[np.ndarray, " k"] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupEstimate(PoseUncertainties):
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
    focal_uncertainty
        u(f)/f of each image's own camera; None where images share one or it is given.
    """

    estimator: str
    images: Int[np.ndarray, " k"]
    failures: tuple[tuple[int, GridposeError], ...]
    camera: AnyCamera
    cameras: Float[np.ndarray, "k s"]
    rotations: Float[np.ndarray, "k 3 3"]
    differing: Bool[np.ndarray, " k"]
    warnings: tuple[Advisory, ...] = ()
    inflation: float = 1.0
    fit: CommonFit | None = None

    @property
    def focal_relative_uncertainty(self) -> float:
        """Return u(f)/f of `camera`, f the mean of fx and fy; 0 where it is given."""
        return focal_relative_uncertainty(self.camera_covariance, *self.camera.as_array()[:2].tolist())
