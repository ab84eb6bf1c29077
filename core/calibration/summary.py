"""Summary of a fit: a Calibration with its covariance and warnings, or a refusal."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.calibration.planar_ambiguity import SecondPose, is_covered, needed_evidence, pose_ambiguous
from core.calibration.priors import (
    FOCAL_PRIOR,
    LENS_PRIOR,
    PRINCIPAL_POINT_PRIOR,
    RADIAL_PRIORS,
    TANGENTIAL_PRIOR,
    Lens,
    camera_prior,
)
from core.calibration.residuals import View
from core.calibration.result import (
    Calibration,
    Observability,
    focal_relative_uncertainty,
    focal_weakly_observable,
    grade,
)
from core.calibration.state import FREE, POSE, centred
from core.calibration.uncertainty import (
    SAG_VARIANCE,
    camera_pose,
    correlation_inflation,
    reprojection,
    valley_sag,
    warnings_for,
)
from core.errors import ADVISED_TILT, Advisory, DegenerateGeometry, FocalNotObservable, NotConverged
from core.geometry import CAMERA_PARAMETERS, Camera, hat, transform
from core.numerics import Fit, median
from core.targets import GridPoints

MAX_RELATIVE_UNCERTAINTY = 10.0  # times the median uncertainty
MAX_RESIDUAL = 0.1  # of the grid's step: beyond it the points are not this grid through this camera
MAX_PRIOR_RESIDUAL = 2.5
"""Times the expected distance from the prior: of eight parameters, one exceeds it in one of eleven images by chance."""
_LEAST_INFORMED = 0.05  # of a prior's variance: less than that the image says too little to contradict it


@dataclass(frozen=True, slots=True)
class FitSummary:
    """A fit with the inflation its residuals call for, the focal length it leaves, and the other tilt."""

    start: str
    fit: Fit[View]
    indices: Int[np.ndarray, " p"]
    inflation: float
    neighbour_correlation: float
    other: SecondPose | None = None

    @property
    def focal_px(self) -> float:
        """Mean of fx and fy."""
        return 0.5 * float(self.fit.state.parameters[0] + self.fit.state.parameters[1])

    @property
    def pose_is_ambiguous(self) -> bool:
        """Whether the other tilt is a pose of its own that the residuals do not rule out."""
        needed = needed_evidence(self.fit.degrees_of_freedom)
        if self.other is None or self.other.evidence >= needed:
            return False
        information = self.fit.information[-6:, -6:] / self.inflation**2
        return not is_covered(self.other, self.fit.state, information)

    @property
    def focal_relative_uncertainty(self) -> float:
        """u(f)/f, 0 where the camera was held fixed."""
        return (
            0.0 if len(self.indices) == len(POSE) else self.inflation * relative_focal_uncertainty(self.fit)
        )


def relative_focal_uncertainty(result: Fit[View]) -> float:
    """u(f)/f of a free fit, not inflated; f is the mean of fx and fy."""
    fx, fy = result.state.parameters[:2].tolist()
    return focal_relative_uncertainty(result.covariance, fx, fy)


def summarise_fit(
    points: GridPoints, start: str, result: Fit[View], indices: Int[np.ndarray, " p"], smallest_scale: float
) -> FitSummary:
    """Return a fit with its inflation; at `smallest_scale` its residuals are rounding errors or too few to estimate it.

    Raises DegenerateGeometry where the fit found its problem singular.
    """
    if result.status == "singular":
        raise DegenerateGeometry("The grid points found do not determine the camera and its pose.")
    inflation, rho = correlation_inflation(points, result) if result.scale > smallest_scale else (1.0, 0.0)
    return FitSummary(start, result, indices, inflation, rho)


def calibration_of(
    points: GridPoints,
    summary: FitSummary,
    *,
    max_focal_uncertainty: float,
    lens: Lens | None = None,
    contradicted: Lens | None = None,
) -> Calibration:
    """Return the calibration that a fit gives, or refuse it.

    `max_focal_uncertainty` is the largest u(f)/f that is answered, `lens` the one whose prior was used, `contradicted`
    one that was stated and ignored because the image contradicts it.
    """
    start, result, indices = summary.start, summary.fit, summary.indices
    view = result.state
    target, centroid = centred(points)
    depth = target @ view.rotation[2] + view.translation_mm[2]
    if np.any(depth <= 0):
        raise DegenerateGeometry("The best fit puts grid points behind the camera.")
    if float(view.rotation[:, 2] @ view.translation_mm) <= 0:
        raise DegenerateGeometry(
            "The grid is seen from behind.",
            "Check that the image is not mirrored and the print not seen through.",
        )
    residuals = np.ascontiguousarray(result.residuals.T)
    # A point that the detector itself calls ten times as uncertain as the rest had a hundredth of their weight: it is
    # reported as rejected, and the statistics do not count it.
    uncertainty = points.standard_uncertainty_px
    used = result.used & (uncertainty <= MAX_RELATIVE_UNCERTAINTY * median(uncertainty))
    # From the centroid to the target's origin: t = t_c - R c, so d = d_c + [R c]× w.
    origin = -view.rotation @ centroid
    to_origin = np.eye(15)
    to_origin[12:, 9:12] = -hat(origin)
    covariance = np.zeros((15, 15))
    # All of it, the priors' part too: a print that is longer one way breaks fx = fy as it breaks the residuals.
    covariance[indices[:, None], indices] = result.covariance * summary.inflation**2
    covariance = to_origin @ covariance @ to_origin.T
    translation = view.translation_mm + origin
    if points.target.scale_standard_uncertainty:
        # A print 1 % too large is taken for one 1 % nearer: the same relative error in every length. It is
        # common to all images of the target, so it belongs to the absolute pose, not the conditional one.
        relative = points.target.scale_standard_uncertainty
        covariance[12:, 12:] += relative**2 * np.outer(translation, translation)
    conditional = np.linalg.inv(result.information[-6:, -6:]) * summary.inflation**2
    conditional = to_origin[9:, 9:] @ conditional @ to_origin[9:, 9:].T
    focal, focal_uncertainty = summary.focal_px, summary.focal_relative_uncertainty
    # Where the focal length is not observable the cost is a flat valley, and the solver may not converge: that is
    # refused as not observable, too, not reported as a failure to converge.
    if focal_uncertainty > max_focal_uncertainty:
        statement = (
            f"is {100 * focal_uncertainty:.1f} % of {focal:.0f} px, more than {100 * max_focal_uncertainty:.0f} %."
            if focal_uncertainty < 0.5
            else "is as large as the value itself."
        )
        raise FocalNotObservable(
            f"The focal length is not observable in this view: its predicted standard uncertainty {statement}",
            None
            if contradicted is None
            else f"The stated lens, {contradicted.focal_px:.0f} px, does not fit this view either: check its focal "
            f"length and the pixel pitch, or tilt the target by {ADVISED_TILT}.",
        )
    if not result.converged:
        raise NotConverged(f"The fit did not converge within {result.iterations} iterations.")
    of_state, of_pose = np.zeros(15), np.zeros(6)
    if len(indices) == len(FREE):
        of_state, of_pose = valley_sag(view, result.covariance * summary.inflation**2, centroid)
    pose = camera_pose(view.rotation, translation, covariance[9:, 9:], conditional, of_pose)
    covariance = covariance + SAG_VARIANCE * np.outer(of_state, of_state)
    statistics = reprojection(residuals, used)
    step = grid_step_px(points, target)
    if statistics.rms_px > MAX_RESIDUAL * step:
        raise NotConverged(
            f"The best fit leaves residuals of {statistics.rms_px:.1f} px where the grid's step is {step:.0f} px: "
            "camera and target as stated do not explain this image.",
            "Check the target's size and the session's intrinsics or lens.",
        )
    chi = result.scale / float(np.mean(points.standard_uncertainty_px))
    warnings = warnings_for(points, pose, statistics, chi, summary.inflation, summary.neighbour_correlation)
    if summary.other is not None and summary.pose_is_ambiguous:
        warnings.append(pose_ambiguous(summary.other.ratio))
    if len(indices) == len(POSE):
        unexplained = any(one.code in ("residuals_exceed_noise", "residuals_correlated") for one in warnings)
        warnings.append(
            Advisory(
                "intrinsics_without_uncertainty",
                "The session's intrinsics were used as given; the pose's uncertainty does not contain theirs.",
                "The residuals may be theirs: compare them with those that the session's images give "
                "(estimator=pooled). They hold for one setting of the lens and one size of images."
                if unexplained
                else None,
            )
        )
    else:
        warnings += prior_warnings(
            points, view.camera, covariance[:8, :8], lens, determined=grade(focal_uncertainty) != "weak"
        )
    if grade(focal_uncertainty) == "weak":
        warnings.append(
            focal_weakly_observable(
                "The image by itself leaves",
                focal_uncertainty,
                "Use the session's camera, which all its images determine together, or tilt the target by "
                f"{ADVISED_TILT}.",
            )
        )
    if contradicted is not None:
        warnings.append(
            Advisory(
                "focal_prior_inconsistent",
                f"The image says f = {focal:.0f} px, the stated lens {contradicted.focal_px:.0f} px; "
                "the lens was ignored.",
                "Check the lens's focal length and the camera's pixel pitch (binning doubles it).",
            )
        )
    return Calibration(
        estimator="given" if len(indices) == len(POSE) else "per_image",
        initialisation=start,
        image_width_px=points.image_width_px,
        image_height_px=points.image_height_px,
        camera=view.camera,
        T_camera_target=transform(view.rotation, translation),
        covariance=covariance,
        pose=pose,
        reprojection=statistics,
        observability=Observability(
            focal_relative_uncertainty=focal_uncertainty,
            condition_number=result.condition_number,
            tilt=math.acos(min(1.0, max(-1.0, float(view.rotation[2, 2])))),
            prior_dominated=_prior_dominated(points, summary, lens) if len(indices) == len(FREE) else (),
            ambiguity_log_likelihood_ratio=summary.other.log_likelihood_ratio
            if summary.other is not None and (summary.other.is_minimum or summary.pose_is_ambiguous)
            else None,
        ),
        warnings=tuple(warnings),
        points=points,
        residuals_px=residuals,
        used=used,
        inflation=summary.inflation,
    )


def _prior_dominated(points: GridPoints, summary: FitSummary, lens: Lens | None) -> tuple[str, ...]:
    """Return the parameters that the prior determines more than the image: posterior variance over half the
    prior's.
    """
    sigma = np.full(8, np.inf)
    sigma[2:4] = PRINCIPAL_POINT_PRIOR * max(points.image_width_px, points.image_height_px)
    sigma[4:6] = RADIAL_PRIORS
    sigma[6:8] = TANGENTIAL_PRIOR
    sigma[:2] = (FOCAL_PRIOR[1] if lens is None else LENS_PRIOR) * summary.focal_px
    dominated = summary.inflation**2 * np.diag(summary.fit.covariance)[:8] > 0.5 * sigma**2
    return tuple(name for name, flag in zip(CAMERA_PARAMETERS[:8], dominated, strict=True) if flag)


def prior_warnings(
    points: GridPoints,
    camera: Camera,
    covariance: Float[np.ndarray, "8 8"],
    lens: Lens | None,
    *,
    determined: bool,
) -> list[Advisory]:
    """Return a warning for parameters that contradict the prior by more than `MAX_PRIOR_RESIDUAL`.

    An estimate that the prior pulled is nearer to it than the image is: where the prior holds, its distance has the
    prior's variance less that of the estimate (`covariance`), and is measured by that. The weak prior on f without a
    lens says nothing against a long lens that the image determines.
    """
    q, Q = camera_prior(points.image_width_px, points.image_height_px, lens)(camera.as_array())
    expected = np.maximum(1.0 - np.einsum("ij,jk,ik->i", Q, covariance, Q), _LEAST_INFORMED)
    names = ("cx_px", "cy_px", "k1", "k2", "p1", "p2", "fx/fy", "f")
    count = 7 if lens is None and determined else 8
    off = np.abs(q) / np.sqrt(expected)
    strained = [
        name for name, value in zip(names[:count], off[:count], strict=True) if value > MAX_PRIOR_RESIDUAL
    ]
    if not strained:
        return []
    return [
        Advisory(
            "prior_residuals_large",
            f"{', '.join(strained)} ended farther from what a single image has to assume of lenses and prints than one "
            "in eighty does by chance; uncertainties may be too small. An image cut to one side does this, too.",
            "Calibrate this camera from several tilted views and give the session those intrinsics; check the print's "
            "length against its width.",
        )
    ]


def grid_step_px(points: GridPoints, target_centred: Float[np.ndarray, "n 3"]) -> float:
    """The mean distance of neighbouring grid points in the image, px."""
    px = points.points_px - points.points_px.mean(axis=0)
    return points.target.pitch_mm * math.sqrt(
        float(np.vdot(px, px) / np.vdot(target_centred, target_centred))
    )
