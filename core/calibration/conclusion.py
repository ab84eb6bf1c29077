"""From a fit to what is reported: a Calibration with its doubt and remarks, or a refusal."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.calibration.model import (
    FREE,
    LENS_PRIOR,
    POSE,
    PRINCIPAL_POINT_PRIOR,
    RADIAL_PRIORS,
    TANGENTIAL_PRIOR,
    Lens,
    View,
    camera_prior,
    centred,
)
from core.calibration.result import Calibration, Observability
from core.calibration.two_fold import SecondPose, is_held, needed_evidence, pose_ambiguous
from core.calibration.uncertainty import camera_pose, correlation_inflation, remarks, reprojection
from core.camera import CAMERA_PARAMETERS, Camera
from core.errors import Advisory, DegenerateGeometry, FocalNotObservable, NotConverged
from core.least_squares import Fit
from core.targets.quantiles import median
from core.targets.specification import GridPoints
from core.transforms import hat, transform

UNTRUSTED = 10.0  # times the median uncertainty
LARGEST_RESIDUAL = 0.1  # of the grid's step: beyond it the points are not this grid through this camera
STRAINED = 2.0  # prior σ; of cameras as assumed one in eight is remarked on at .05 px of noise, one in six at .008 px


@dataclass(frozen=True, slots=True)
class Judged:
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
        return not is_held(self.other, self.fit.state, information)

    @property
    def focal_relative_uncertainty(self) -> float:
        """u(f)/f, 0 where the camera was held fixed."""
        return (
            0.0 if len(self.indices) == len(POSE) else self.inflation * relative_focal_uncertainty(self.fit)
        )


def relative_focal_uncertainty(result: Fit[View]) -> float:
    """u(f)/f of a free fit, not inflated; f is the mean of fx and fy."""
    C, parameters = result.covariance, result.state.parameters
    variance = 0.25 * float(C[0, 0] + 2.0 * C[0, 1] + C[1, 1])
    return math.sqrt(max(variance, 0.0)) / (0.5 * float(parameters[0] + parameters[1]))


def judge(
    points: GridPoints, start: str, result: Fit[View], indices: Int[np.ndarray, " p"], smallest_scale: float
) -> Judged:
    """Look at the residuals. At `smallest_scale` what is left are rounding errors or too few to tell anything from.

    Raises DegenerateGeometry where the fit found its problem singular.
    """
    if result.status == "singular":
        raise DegenerateGeometry("The grid points found do not determine the camera and its pose.")
    inflation, rho = correlation_inflation(points, result) if result.scale > smallest_scale else (1.0, 0.0)
    return Judged(start, result, indices, inflation, rho)


def conclude(
    points: GridPoints,
    judged: Judged,
    *,
    gate: float,
    lens: Lens | None = None,
    contradicted: Lens | None = None,
) -> Calibration:
    """Turn a fit into a Calibration, or refuse it.

    `gate` is the largest u(f)/f let through, `lens` the one whose prior was used, `contradicted` one that was stated
    and left out because the image says otherwise.
    """
    start, result, indices = judged.start, judged.fit, judged.indices
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
    # reported as what it was, left out, and does not stand in the statistics as if it had been believed.
    uncertainty = points.standard_uncertainty_px
    used = result.used & (uncertainty <= UNTRUSTED * median(uncertainty))
    # From the centroid to the target's origin: t = t_c - R c, so d = d_c + [R c]× w.
    origin = -view.rotation @ centroid
    to_origin = np.eye(15)
    to_origin[12:, 9:12] = -hat(origin)
    covariance = np.zeros((15, 15))
    # All of it, the priors' part too: a print that is longer one way breaks fx = fy as it breaks the residuals.
    covariance[indices[:, None], indices] = result.covariance * judged.inflation**2
    covariance = to_origin @ covariance @ to_origin.T
    translation = view.translation_mm + origin
    if points.target.pitch_standard_uncertainty_mm:
        # A print 1 % too large is taken for one 1 % nearer: the same relative error in every length. It is
        # common to all images of the target, so it belongs to the absolute pose, not the conditional one.
        relative = points.target.pitch_standard_uncertainty_mm / points.target.pitch_mm
        covariance[12:, 12:] += relative**2 * np.outer(translation, translation)
    conditional = np.linalg.inv(result.information[-6:, -6:]) * judged.inflation**2
    conditional = to_origin[9:, 9:] @ conditional @ to_origin[9:, 9:].T
    focal, focal_uncertainty = judged.focal_px, judged.focal_relative_uncertainty
    # Where focal length cannot be told the cost is a flat valley, on which the solver may walk on without
    # end: that is the refusal's case too, not a failure to converge.
    if focal_uncertainty > gate:
        doubt = (
            f"is {100 * focal_uncertainty:.1f} % of {focal:.0f} px, more than {100 * gate:.0f} %."
            if focal_uncertainty < 0.5
            else "is as large as the value itself."
        )
        raise FocalNotObservable(
            f"The focal length is not observable in this view: its predicted standard uncertainty {doubt}",
            None
            if contradicted is None
            else f"The stated lens, {contradicted.focal_px:.0f} px, does not fit this view either: check its focal "
            "length and the pixel pitch, or tilt the target by 15° or more.",
        )
    if not result.converged:
        raise NotConverged(f"The fit did not converge within {result.iterations} iterations.")
    pose = camera_pose(view.rotation, translation, covariance[9:, 9:], conditional)
    statistics = reprojection(residuals, used)
    step = grid_step_px(points, target)
    if statistics.rms_px > LARGEST_RESIDUAL * step:
        raise NotConverged(
            f"The best fit leaves residuals of {statistics.rms_px:.1f} px where the grid's step is {step:.0f} px: "
            "camera and target as stated do not explain this image.",
            "Check the target's size and the session's intrinsics or lens.",
        )
    chi = result.scale / float(np.mean(points.standard_uncertainty_px))
    warnings = remarks(points, pose, statistics, chi, judged.inflation, judged.neighbour_correlation)
    if judged.other is not None and judged.pose_is_ambiguous:
        warnings.append(pose_ambiguous(judged.other.ratio))
    if len(indices) == len(POSE):
        warnings.append(
            Advisory(
                "intrinsics_taken_as_exact",
                "The session's intrinsics were used as given; the pose's uncertainty does not contain theirs.",
            )
        )
    else:
        warnings += strained_priors(points, view.camera, lens)
    if contradicted is not None:
        warnings.append(
            Advisory(
                "lens_prior_contradicted",
                f"The image says f = {focal:.0f} px, the stated lens {contradicted.focal_px:.0f} px; "
                "the lens was left out.",
                "Check the lens's focal length and the camera's pixel pitch (binning doubles it).",
            )
        )
    return Calibration(
        estimator="given" if len(indices) == len(POSE) else "per_image",
        start=start,
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
            prior_dominated=_prior_dominated(points, judged, lens) if len(indices) == len(FREE) else (),
            pose_ambiguity_ratio=judged.other.ratio
            if judged.other is not None and (judged.other.is_minimum or judged.pose_is_ambiguous)
            else None,
        ),
        warnings=tuple(warnings),
        points=points,
        residuals_px=residuals,
        used=used,
    )


def _prior_dominated(points: GridPoints, judged: Judged, lens: Lens | None) -> tuple[str, ...]:
    """Name the parameters of which the prior tells more than the image: posterior variance over half the
    prior's.
    """
    sigma = np.full(8, np.inf)
    sigma[2:4] = PRINCIPAL_POINT_PRIOR * points.image_width_px
    sigma[4:6] = RADIAL_PRIORS
    sigma[6:8] = TANGENTIAL_PRIOR
    if lens is not None:
        sigma[:2] = LENS_PRIOR * judged.focal_px
    dominated = np.diag(judged.fit.covariance)[:8] > 0.5 * sigma**2
    return tuple(name for name, flag in zip(CAMERA_PARAMETERS[:8], dominated, strict=True) if flag)


def strained_priors(points: GridPoints, camera: Camera, lens: Lens | None) -> list[Advisory]:
    """Remark on parameters that ended more than two σ from what lenses are usually like."""
    q, _ = camera_prior(points.image_width_px, points.image_height_px, lens)(camera.as_array())
    names = ("cx_px", "cy_px", "k1", "k2", "p1", "p2", "fx/fy", "f")
    strained = [name for name, value in zip(names, q, strict=False) if abs(value) > STRAINED]
    if not strained:
        return []
    return [
        Advisory(
            "priors_strained",
            f"{', '.join(strained)} ended more than {STRAINED:g} σ from what a single image has to assume of lenses "
            "and prints; uncertainties may be too small.",
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
