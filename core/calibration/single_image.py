"""One image: starts, MAP refinement, the refusal, and the doubt of what is left.

One planar view separates focal length and principal point from depth only through tilt and distortion, so
weak priors (METHOD: what lenses are like) regularise the fit, and a view whose predicted u(f)/f still exceeds
2 % is refused: its residual would be as small as ever while its pose is millimetres off.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from jaxtyping import Float

from core.calibration import closed_form
from core.calibration.conclusion import Judged, conclude, judge, relative_focal_uncertainty
from core.calibration.homography import estimate_homography
from core.calibration.model import (
    FREE,
    LENS_PRIOR,
    POSE,
    SMALLEST_NOISE_PX,
    Lens,
    View,
    centred,
    image_centre,
    retract,
    retract_pose,
    view_of,
    view_prior,
    view_residuals,
)
from core.calibration.result import Calibration
from core.calibration.two_fold import SecondPose, better_start, needed_evidence, second_pose
from core.calibration.validity import check_camera, check_lens, check_points
from core.camera import Camera, project, undistort_points
from core.errors import DegenerateGeometry, GridposeError, OriginUnknown
from core.least_squares import Fit, Prior, fit
from core.targets.specification import GridPoints

FOCAL_GATE = 0.02
"""Largest predicted u(f)/f that is reported as a measurement."""
LENS_GATE = 2.0 * LENS_PRIOR
"""The same where a lens is stated: its prior alone leaves 5 %."""
START_FACTORS = (0.6, 1.0, 1.8)  # of the image width, where no closed form is plausible
PLAUSIBLE_START = (0.3, 10.0)
ITERATIONS, TRIAL_ITERATIONS = 100, 10
HOPELESS = 3.0  # times the wider gate: no minimum at the end of the valley brings the uncertainty down to it
SUBSET = 500  # points enough to choose a start by
SPARE_OBSERVATIONS = 30
"""With fewer observations beyond the parameters than this, residuals alone do not tell the noise."""


def calibrate_points(
    points: GridPoints, *, lens: Lens | None = None, intrinsics: Camera | None = None
) -> Calibration:
    """Estimate camera and pose from the grid points of one image.

    With `intrinsics` given only the pose is estimated (estimator "given") and they are taken as exact; else
    all is (estimator "per_image"). A stated `lens` is a 5 % prior on the focal length, unless the image by itself
    determines it and contradicts the lens; then the lens is left out, with a remark.

    Raises InvalidArgument for arguments no camera has, OriginUnknown for a part of a grid that may be any part,
    DegenerateGeometry for too few or collinear points,
    NotConverged where no camera explains them, and FocalNotObservable where the predicted u(f)/f exceeds 2 %
    (with a lens: 10 %); each carries the points.
    """
    try:
        if points.origin == "unknown":  # whose columns and rows may be exchanged, too
            raise OriginUnknown(
                "Part of the grid is in view, and nothing tells which part: the pose is known but for whole squares."
            )
        check_points(points)
        located = dataclasses.replace(points, measured_points_target=points.points_target)  # computed once
        if intrinsics is not None:
            return conclude(points, _judge_pose(located, intrinsics), gate=math.inf)
        free = _judge_free(located, None)
        if lens is None:
            return conclude(points, _with_other(located, free, None), gate=FOCAL_GATE)
        check_lens(lens, points)
        u = free.focal_relative_uncertainty
        distance = abs(math.log(lens.focal_px / free.focal_px))
        if free.fit.converged and distance > 3.0 * math.hypot(LENS_PRIOR, u):
            return conclude(points, _with_other(located, free, None), gate=FOCAL_GATE, contradicted=lens)
        return conclude(
            points, _with_other(located, _judge_free(located, lens), lens), gate=LENS_GATE, lens=lens
        )
    except GridposeError as failure:
        failure.points = points
        raise
    except (np.linalg.LinAlgError, ArithmeticError) as error:
        # The checks above leave only inputs without meaning to come here.
        raise DegenerateGeometry(
            "The grid points found do not determine the camera and its pose.", points=points
        ) from error


def plausible_start(H: Float[np.ndarray, "3 3"], points: GridPoints) -> closed_form.ClosedForm | None:
    """Return closed form B1, or None where the view gives none or an absurd focal length."""
    try:
        start = closed_form.from_homography(H, points, image_centre(points), single_focal=True)
    except DegenerateGeometry:
        return None  # no failure: a near fronto-parallel view has no closed form
    low, high = (factor * points.image_width_px for factor in PLAUSIBLE_START)
    return start if low < start.camera.fx_px < high else None


def assumed_focals(points: GridPoints, lens: Lens | None) -> list[float]:
    """Focal lengths to start from where no view gives one: the lens's own, else wide, normal and long."""
    return (
        [lens.focal_px] if lens is not None else [factor * points.image_width_px for factor in START_FACTORS]
    )


def _starts(points: GridPoints, lens: Lens | None) -> list[tuple[str, View]]:
    """Closed form B1 where plausible; otherwise, and beside it where a lens is stated, assumed focal lengths."""
    H = estimate_homography(points.points_target[:, :2], points.points_px)
    plausible, centre = plausible_start(H, points), image_centre(points)
    named = [("vanishing_point", plausible)] if plausible is not None else []
    if plausible is None or lens is not None:
        named += [
            ("nominal", closed_form.nominal(H, points, Camera(f, f, *centre)))
            for f in assumed_focals(points, lens)
        ]
    return [(name, view_of(start, points)) for name, start in named]


def _judge_free(points: GridPoints, lens: Lens | None) -> Judged:
    """Refine every start and keep the one of least cost; of large grids the start is chosen on a part."""
    if len(points) < 8:
        raise DegenerateGeometry(f"Camera and pose need at least 8 grid points, {len(points)} were found.")
    starts = _starts(points, lens)
    if len(points) > 2 * SUBSET:
        part = _part(points, SUBSET)
        # A part has a centroid of its own, to which a view's translation refers.
        starts = [(name, _recentred(view, points, part)) for name, view in starts]
        name, chosen = _best_fit(part, lens, starts)
        starts = [(name, _recentred(chosen.state, part, points))]
    name, best = _best_fit(points, lens, starts)
    return judge(points, name, best, FREE, _smallest_scale(points, len(FREE)))


def _best_fit(points: GridPoints, lens: Lens | None, starts: list[tuple[str, View]]) -> tuple[str, Fit[View]]:
    """Refine every start a little, and the one of least cost to the end."""
    evaluate, prior = view_residuals(points, free=True), view_prior(points, lens)
    scale, uncertainty = _smallest_scale(points, len(FREE)), points.standard_uncertainty_px

    def refined(start: View, iterations: int) -> Fit[View]:
        return fit(
            evaluate,
            retract,
            start,
            uncertainty,
            prior=prior,
            smallest_scale=scale,
            iteration_limit=iterations,
        )

    if len(starts) == 1:
        name, start = starts[0]
        return name, refined(start, ITERATIONS)
    tried = [(name, refined(start, TRIAL_ITERATIONS)) for name, start in starts]
    name, best = min(tried, key=lambda item: _rank(item[1], points, prior))
    hopeless = relative_focal_uncertainty(best) > HOPELESS * LENS_GATE
    return name, best if best.converged or hopeless else refined(best.state, ITERATIONS)


def _rank(result: Fit[View], points: GridPoints, prior: Prior[View]) -> tuple[bool, bool, float]:
    """The smaller the better; costs equal to within a thousandth are the same minimum, and the first start's."""
    return result.status == "singular", not result.converged, round(_total(result, points, prior), 3)


def _smallest_scale(points: GridPoints, parameters: int) -> float:
    """The least noise assumed, px: the detector's own figure where residuals are too few to tell."""
    if 2 * len(points) - parameters < SPARE_OBSERVATIONS:
        return max(SMALLEST_NOISE_PX, float(np.mean(points.standard_uncertainty_px)))
    return SMALLEST_NOISE_PX


def _part(points: GridPoints, count: int) -> GridPoints:
    """Return `count` of the grid points, scattered without pattern (a regular step may fall on a single column) and
    the same ones every time.
    """
    chosen = np.sort(np.random.default_rng(0).permutation(len(points))[:count])
    measured = points.measured_points_target
    return dataclasses.replace(
        points,
        column=points.column[chosen],
        row=points.row[chosen],
        points_px=points.points_px[chosen],
        standard_uncertainty_px=points.standard_uncertainty_px[chosen],
        measured_points_target=None if measured is None else measured[chosen],
    )


def _recentred(view: View, of: GridPoints, to: GridPoints) -> View:
    """Return the same view with its translation at the centroid of other points of the grid."""
    shift = centred(to)[1] - centred(of)[1]
    return dataclasses.replace(view, translation_mm=view.translation_mm + view.rotation @ shift)


def _total(result: Fit[View], points: GridPoints, prior: Prior[View]) -> float:
    """Twice the negative log posterior, comparable between fits of the same points with different σ and rejections:
    a fit that leaves points out pays for each as much as it saves.
    """
    distance = np.sqrt(np.sum(result.residuals**2, axis=0))
    scale = max(result.scale, SMALLEST_NOISE_PX)
    data = 4.0 * len(points) * math.log(scale) + float(np.sum(np.minimum((distance / scale) ** 2, 32.0)))
    q, _ = prior(result.state)
    return data + float(q @ q)


def _judge_pose(points: GridPoints, camera: Camera) -> Judged:
    if len(points) < 5:
        raise DegenerateGeometry(f"A pose needs at least 5 grid points, {len(points)} were found.")
    check_camera(camera, points)
    # The homography of undistorted points, so that a strong lens does not spoil the start.
    normalised = undistort_points(points.points_px, camera)
    again = project(np.column_stack([normalised, np.ones(len(normalised))]), camera)
    if float(np.mean(np.abs(again - points.points_px) > 0.5)) > 0.1:
        raise DegenerateGeometry(
            "The given distortion folds back within the image: these pixels have no direction.",
            "Check the session's intrinsics: k1, k2, p1, p2, k3 in OpenCV's order, for this image size.",
        )
    H = camera.matrix @ estimate_homography(points.points_target[:, :2], normalised)
    start = view_of(closed_form.nominal(H, points, camera), points)
    judged = _fit_pose(points, start)
    if not judged.fit.converged:
        judged = _fit_pose(points, better_start(points, judged.fit.state))
    other = _other_minimum(points, judged)
    if other is not None and other.cost < other.first_cost:
        judged = _fit_pose(points, other.view)
        other = _other_minimum(points, judged)
    return dataclasses.replace(judged, other=other)


def _fit_pose(points: GridPoints, start: View) -> Judged:
    scale = _smallest_scale(points, len(POSE))
    result = fit(
        view_residuals(points, free=False),
        retract_pose,
        start,
        points.standard_uncertainty_px,
        smallest_scale=scale,
    )
    return judge(points, "nominal", result, POSE, scale)


def _other_minimum(points: GridPoints, judged: Judged) -> SecondPose | None:
    """Return the pose of the opposite tilt before the same camera, if it is a minimum of its own."""
    result, uncertainty = judged.fit, points.standard_uncertainty_px
    if not result.converged:
        return None
    cost = float(np.sum((result.residuals[:, result.used] / uncertainty[result.used]) ** 2))
    variance = (judged.inflation * result.scale / float(np.mean(uncertainty))) ** 2
    return second_pose(points, result.state, result.used, cost, variance)


def _with_other(points: GridPoints, judged: Judged, lens: Lens | None) -> Judged:
    """Return the better of a free fit's two minima, with the other.

    Where the image by itself tells the focal length, it tells the perspective that rules the other pose out. Where a
    stated lens tells it, camera and pose together may follow the wrong tilt: then the fit is made again from the other
    one, and compared with all that priors say.
    """
    other = _other_minimum(points, judged)
    if other is None:
        return judged
    needed = needed_evidence(judged.fit.degrees_of_freedom)
    if judged.focal_relative_uncertainty <= FOCAL_GATE and other.evidence >= needed:
        return dataclasses.replace(judged, other=other)
    _, again = _best_fit(points, lens, [(judged.start, other.view)])
    if not again.converged or _back(again.state, judged.fit.state, other.view):
        return dataclasses.replace(judged, other=other)
    best = judge(points, judged.start, again, FREE, _smallest_scale(points, len(FREE)))
    if _total(again, points, view_prior(points, lens)) >= _total(
        judged.fit, points, view_prior(points, lens)
    ):
        judged, best = best, judged
    return dataclasses.replace(best, other=_released(points, best, judged.fit, lens))


def _back(view: View, first: View, other: View) -> bool:
    """Tell whether a fit that began at the other tilt ended at the first."""
    return float(view.rotation[:, 2] @ first.rotation[:, 2]) > float(
        view.rotation[:, 2] @ other.rotation[:, 2]
    )


def _released(points: GridPoints, best: Judged, second: Fit[View], lens: Lens | None) -> SecondPose:
    """Return the second of two free fits, over the points of the first; what priors say of each camera counts too."""
    prior, uncertainty = view_prior(points, lens), points.standard_uncertainty_px
    used = best.fit.used & second.used
    variance = (best.inflation * best.fit.scale / float(np.mean(uncertainty))) ** 2
    costs = []
    for result in (best.fit, second):
        q, _ = prior(result.state)
        squares = float(np.sum((result.residuals[:, used] / uncertainty[used]) ** 2))
        costs.append(squares + variance * float(q @ q))
    return SecondPose(second.state, costs[0], costs[1], variance)
