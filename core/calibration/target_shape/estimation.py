"""Shape of the printed target: each grid point's deviation from its nominal place, from many views.

A print is some hundredths of a millimetre off in its plane and bows by tenths out of it. One camera and one rigid
target in views of many directions determine both: what all views have in common is either the camera's or the
target's, and the target turns. Camera, poses and points are estimated together (`normal_equations`) with weak priors on
the deviations: each coordinate of a point by itself (σ = .02 pitches), and the shapes that prints and boards take, a
bow x², xy, y² (σ = .02 of the extent), a print longer one way than the other and a sheared one (σ = .01).

Where the target lies, how it is turned and how large it is as a whole is convention (seven gauge freedoms): deviations
are those after the best similarity, so that the pitch stays the nominal one on the average.

Deviations are judged significant by χ² of what the noise alone would make of a perfect target, at 99.9 %.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.priors import Lens, camera_prior
from core.calibration.state import SMALLEST_NOISE_PX
from core.calibration.target_shape.deformation import (
    TargetShape,
    gauge_of,
    low_order_shapes,
    projected,
    shape_prior,
    summarise_deviations,
)
from core.calibration.target_shape.normal_equations import (
    Normals,
    SeenPoints,
    ShapeState,
    inliers_of,
    normals_at,
    residuals_at,
    rms_px_of,
    sum_of_squares,
)
from core.calibration.target_shape.planar_views import count_directions, planar_views
from core.errors import InvalidArgument, NotConverged, TargetShapeNotObservable
from core.geometry import (
    CAMERA_PARAMETERS,
    AnyCamera,
    camera_from_array,
    free_parameters,
)
from core.numerics import CAUCHY_C, scaled_inverse
from core.targets import GridPoints, TargetSpec

MIN_DIRECTIONS = 8
"""Fewest views from directions that differ as `count_directions` counts them."""
MAX_BOW_UNCERTAINTY = 1e-3
"""Of the target's extent: a bow that is less certain than this is not observed."""
MAX_POINTS = 1200
THIRD_RADIAL_PRIOR = 0.5
"""σ of k3 about 0, as of k2: the estimators of cameras hold it at 0."""
_ROBUST_STEPS, _STEPS = 8, 20
_K3 = 8
"""Place of k3 among the parameters of Brown's model."""
_SETTLED = 1e-3  # of the step's own uncertainty


def estimate_target_shape(
    views: Sequence[GridPoints],
    *,
    lens: Lens | None = None,
    least_directions: int = MIN_DIRECTIONS,
    start: AnyCamera | None = None,
) -> TargetShape:
    """Estimate the shape of the target that all views show, from `least_directions` at least.

    `start` is a camera of another lens model than Brown's, where the images ask for one (`select_lens`): what a lens
    lacks is taken for the print's.

    Raises InvalidArgument for no views, several targets or sizes of image, and targets of more than `MAX_POINTS`
    points; TargetShapeNotObservable where the views do not determine the shape; and what `calibrate_views` raises.
    """
    if not views:
        raise InvalidArgument("At least one view is needed.")
    target = views[0].target
    if any(v.target != target for v in views):
        raise InvalidArgument("All views must show the same target.", "Refine one target at a time.")
    if target.size > MAX_POINTS:
        raise InvalidArgument(
            f"The target has {target.size} points; its shape is estimated for up to {MAX_POINTS}.",
            "Use a coarser target where its shape matters.",
        )
    ideal = [replace(v, measured_points_target=None) for v in views]
    planar = planar_views(ideal, lens, start)
    kept, rotations = planar.kept, planar.T_camera_target[:, :3, :3]
    directions = count_directions(rotations)
    if directions < least_directions:
        raise TargetShapeNotObservable(
            f"The images show the target from {directions} directions that differ by 5° and are tilted by 10° or more; "
            f"its shape takes {least_directions}."
        )
    fit = _Fit.of([views[i] for i in kept], lens)
    middles = planar.T_camera_target[:, :3, 3] + rotations @ fit.middle
    state = ShapeState(planar.camera.as_array(), rotations, middles, fit.nominal.copy())
    weights = tuple(np.ones(len(v.place)) for v in fit.views)
    residuals = residuals_at(state, fit.views)
    before = rms_px_of(fit.views, residuals, planar.used or inliers_of(residuals))
    state = fit.robust(state, weights)
    used = inliers_of(residuals_at(state, fit.views))
    state, normals, scale = fit.plain(state, used)
    return _shape_of(fit, state, normals, scale, used, kept, directions, before)


@dataclass(frozen=True, slots=True)
class _Fit:
    """The problem: views over the points that were seen, priors, and gauge."""

    target: TargetSpec
    place: Int[np.ndarray, " n"]
    nominal: Float[np.ndarray, "n 3"]  # about the middle
    middle: Float[np.ndarray, "3"]
    views: tuple[SeenPoints, ...]
    prior: Float[np.ndarray, "p p"]
    lens: Lens | None
    size_px: tuple[int, int]

    @classmethod
    def of(cls, views: Sequence[GridPoints], lens: Lens | None) -> _Fit:
        target = views[0].target
        cells = [v.row * target.grid_columns + v.column for v in views]
        place = np.unique(np.concatenate(cells))
        everywhere = target.points_target()[place]
        middle = everywhere.mean(axis=0)
        nominal = everywhere - middle
        return cls(
            target,
            place,
            nominal,
            middle,
            tuple(
                SeenPoints(np.searchsorted(place, cell), v.points_px, v.standard_uncertainty_px)
                for cell, v in zip(cells, views, strict=True)
            ),
            shape_prior(nominal, target.pitch_mm),
            lens,
            (views[0].image_width_px, views[0].image_height_px),
        )

    def with_priors(
        self, state: ShapeState, normals: Normals, scale: float
    ) -> tuple[Float[np.ndarray, "z z"], Float[np.ndarray, " z"]]:
        """Return information and gradient of camera and deviations, σ per unit of stated uncertainty being `scale`."""
        H, b = normals.information / scale**2, normals.gradient / scale**2
        size = len(state.parameters)
        of_brown = size == len(CAMERA_PARAMETERS)
        q, Q = camera_prior(*self.size_px, self.lens, size if of_brown else None, size)(state.parameters)
        H[:size, :size] += Q.T @ Q
        b[:size] += Q.T @ q
        if of_brown:
            H[_K3, _K3] += THIRD_RADIAL_PRIOR**-2
            b[_K3] -= state.parameters[_K3] * THIRD_RADIAL_PRIOR**-2
        H[size:, size:] += self.prior
        b[size:] -= self.prior @ (state.points_mm - self.nominal).ravel()
        return H, b

    def step(
        self, state: ShapeState, weights: Sequence[Float[np.ndarray, " _"]], scale: float
    ) -> tuple[ShapeState, float]:
        """Return the next state and the step's length in its own uncertainty."""
        normals = normals_at(state, self.views, weights)
        H, b = self.with_priors(state, normals, scale)
        unit = 1.0 / np.sqrt(np.diag(H))
        z = unit * np.linalg.solve(H * np.outer(unit, unit), unit * b)
        return state.moved(z, normals.poses(z)), math.sqrt(max(float(z @ b), 0.0))

    def robust(self, state: ShapeState, weights: tuple[Float[np.ndarray, " _"], ...]) -> ShapeState:
        """Iterate with Cauchy weights, the noise from the residuals' median."""
        for _ in range(_ROBUST_STEPS):
            distance = [np.hypot(*r) for r in residuals_at(state, self.views)]
            scale = max(float(np.median(np.concatenate(distance))) / 1.177410, self.least_scale)
            weights = tuple(1.0 / (1.0 + (d / (CAUCHY_C * scale)) ** 2) for d in distance)
            state, length = self.step(state, weights, scale)
            if length < 0.1:
                break
        return state

    def plain(
        self, state: ShapeState, used: tuple[Bool[np.ndarray, " _"], ...]
    ) -> tuple[ShapeState, Normals, float]:
        """Iterate with the points used to the end; return the system there and the noise's scale.

        Residuals larger than stated increase all uncertainties. Smaller ones do not reduce them: next to edges bent by
        a strong lens, corners are off equally in all views. Their stated uncertainty includes that, and residuals do
        not show it.
        """
        weights = tuple(u.astype(np.float64) for u in used)
        parameters = len(state.parameters) + 6 * len(self.views) + 3 * len(self.place) - 7
        freedom = max(2 * sum(int(u.sum()) for u in used) - parameters, 1)
        for _ in range(_STEPS):
            squares = sum_of_squares(residuals_at(state, self.views), used)
            scale = max(math.sqrt(squares / freedom), 1.0)
            state, length = self.step(state, weights, scale)
            if length < _SETTLED * math.sqrt(parameters):
                normals = normals_at(state, self.views, weights)
                scale = max(math.sqrt(sum_of_squares(normals.residuals, used) / freedom), 1.0)
                return state, normals, scale
        raise NotConverged("The target's shape did not settle.", "Add images from more directions.")

    @property
    def least_scale(self) -> float:
        return SMALLEST_NOISE_PX / float(
            np.median(np.concatenate([v.standard_uncertainty_px for v in self.views]))
        )


def _shape_of(
    fit: _Fit,
    state: ShapeState,
    normals: Normals,
    scale: float,
    used: tuple[Bool[np.ndarray, " _"], ...],
    kept: Int[np.ndarray, " k"],
    directions: int,
    before_px: float,
) -> TargetShape:
    H, _ = fit.with_priors(state, normals, scale)
    C = scaled_inverse(H)
    # H⁻¹ = A⁻¹ + (what the deviations' covariance adds), A the camera's information were the target known, and k3 held.
    size = len(state.parameters)
    of_shape, free = np.zeros((size, size)), free_parameters(size)
    by_shape = np.linalg.solve(H[:free, :free], H[:free, size:])
    of_shape[:free, :free] = by_shape @ C[size:, size:] @ by_shape.T
    gauge = gauge_of(fit.nominal)
    deviations = (state.points_mm - fit.nominal).ravel()
    deviations = deviations - gauge @ (gauge.T @ deviations)
    about = C[size:, size:]
    covariance = projected(about, gauge)
    # Of a perfect target: what priors hold back does not scatter.
    noise = projected(about - about @ fit.prior @ about, gauge)
    measures = low_order_shapes(fit.nominal, deviations, covariance)
    extent = float(np.max(np.ptp(fit.nominal, axis=0)))
    uncertainty = max(m.standard_uncertainty for m in measures[:3])
    if uncertainty > MAX_BOW_UNCERTAINTY * extent:
        raise TargetShapeNotObservable(
            f"The images leave the target's bow uncertain by {uncertainty:.2g} mm; the limit is "
            f"{MAX_BOW_UNCERTAINTY * extent:.2g} mm."
        )
    freedom = max(2 * sum(int(u.sum()) for u in used) - size - 6 * len(kept) - len(deviations) + 7, 1)
    return TargetShape(
        target=fit.target,
        column=fit.place % fit.target.grid_columns,
        row=fit.place // fit.target.grid_columns,
        deviations_mm=deviations.reshape(-1, 3),
        covariance=covariance,
        in_plane=summarise_deviations(deviations, covariance, noise, (0, 1)),
        out_of_plane=summarise_deviations(deviations, covariance, noise, (2,)),
        bow_x_mm=measures[0],
        bow_y_mm=measures[1],
        twist_mm=measures[2],
        aspect=measures[3],
        shear=measures[4],
        camera=camera_from_array(state.parameters),
        camera_covariance=C[:size, :size],
        shape_covariance=0.5 * (of_shape + of_shape.T),
        used_views=kept,
        single_direction_uncertainty=_single_direction_uncertainty(fit, state, H, scale, used),
        directions=directions,
        rms_before_px=before_px,
        rms_px=rms_px_of(fit.views, normals.residuals, used),
        reduced_chi2=sum_of_squares(normals.residuals, used) / freedom,
    )


def _single_direction_uncertainty(
    fit: _Fit,
    state: ShapeState,
    information: Float[np.ndarray, "z z"],
    scale: float,
    used: Sequence[Bool[np.ndarray, " _"]],
) -> Float[np.ndarray, "5"]:
    """Return `TargetShape.single_direction_uncertainty`: the information of the same views, turned, is added."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = replace(
        state, rotations=quarter @ state.rotations, translations_mm=state.translations_mm @ quarter.T
    )
    more = normals_at(turned, fit.views, [u.astype(np.float64) for u in used]).information / scale**2
    C = scaled_inverse(information + more)
    size = len(state.parameters)
    covariance = projected(C[size:, size:], gauge_of(fit.nominal))
    measures = low_order_shapes(fit.nominal, np.zeros(len(covariance)), covariance)
    return np.array([m.standard_uncertainty for m in measures])
