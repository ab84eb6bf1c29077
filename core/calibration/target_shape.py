"""The target as it was printed and lies: each grid point's departure from its place, from many views.

A print is some hundredths of a millimetre off in its plane and bows by tenths out of it. One camera and one rigid
target in views of many directions determine both: what all views have in common is either the camera's or the
target's, and the target turns. Camera, poses and points are estimated together (`shape_normals`) with weak priors on
the departures: each coordinate of a point by itself (σ = .02 pitches), and the shapes that prints and boards take, a
bow x², xy, y² (σ = .02 of the extent), a print longer one way than the other and a sheared one (σ = .01).

Where the target lies, how it is turned and how large it is as a whole is convention (seven gauge freedoms): departures
are those after the best similarity, so that the pitch stays the nominal one on the average.

Departures are judged significant by χ² of what the noise alone would make of a perfect target, at 99.9 %.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.model import SMALLEST_NOISE_PX, Lens, camera_prior
from core.calibration.pooled import calibrate_views
from core.calibration.shape_departures import (
    Departure,
    Measure,
    departure_of,
    gauge_of,
    low_order_shapes,
    projected,
    shape_prior,
)
from core.calibration.shape_normals import (
    CAMERA,
    Normals,
    SeenPoints,
    ShapeState,
    normals_at,
    residuals_at,
)
from core.camera import Camera
from core.errors import InvalidArgument, NotConverged, TargetShapeNotObservable
from core.least_squares import CAUCHY_C, REJECTION
from core.targets.specification import GridPoints, TargetSpec

LEAST_DIRECTIONS = 8
"""Views from directions that differ by `APART`, tilted by `TILTED` or more, below which nothing is estimated."""
APART = math.radians(5.0)
TILTED = math.radians(10.0)
LARGEST_BOW_DOUBT = 1e-3
"""Of the target's extent: a bow that is less certain than this is not observed."""
MOST_POINTS = 1200
THIRD_RADIAL_PRIOR = 0.5
"""σ of k3 about 0, as of k2: the estimators of cameras hold it at 0."""
_ROBUST_STEPS, _STEPS = 8, 20
_K3 = CAMERA - 1
_SETTLED = 1e-3  # of the step's own uncertainty


@dataclass(frozen=True, slots=True)
class TargetShape:
    """A target as it is. Arrays run over the n points that were seen, row-major.

    `departures_mm` in the target frame (x, y, z; z into the board), `covariance` (3 n, 3 n) in mm², x, y, z of one
    point after another. Of the quadratic that fits best, `bow_x_mm` is how far the middle of a row stands out along z
    from the line between its ends, `bow_y_mm` the same of a column, `twist_mm` how far the corners stand out of the
    plane, two up and two down. `aspect` is the length along x over that along y, less 1; `shear` by how much less than
    90° the axes meet, rad. `camera` and `camera_covariance` are those of the joint fit: the doubt of the target's shape
    is in them, by `shape_covariance`. `used_views` are the views that count, by their index. `doubt_if_turned` is what
    the standard uncertainties of bows, twist, aspect and shear would be, had every view been taken once more with the
    camera turned by 90° about its axis: that tells a longer side of the print from a camera's oblong pixels.
    """

    target: TargetSpec
    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    departures_mm: Float[np.ndarray, "n 3"]
    covariance: Float[np.ndarray, "p p"]
    in_plane: Departure
    out_of_plane: Departure
    bow_x_mm: Measure
    bow_y_mm: Measure
    twist_mm: Measure
    aspect: Measure
    shear: Measure
    camera: Camera
    camera_covariance: Float[np.ndarray, "9 9"]
    shape_covariance: Float[np.ndarray, "9 9"]
    used_views: Int[np.ndarray, " k"]
    doubt_if_turned: Float[np.ndarray, "5"]
    directions: int
    rms_before_px: float
    rms_px: float
    reduced_chi2: float

    @property
    def standard_uncertainty_mm(self) -> Float[np.ndarray, "n 3"]:
        """Standard uncertainty of each departure."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0)).reshape(-1, 3)

    def applied(self, points: GridPoints) -> GridPoints:
        """Return the same points with their places on this very target in place of the ideal ones."""
        if points.target != self.target:
            raise InvalidArgument("These points are another target's.")
        everywhere = self.target.points_target()
        everywhere[self.row * self.target.grid_columns + self.column] += self.departures_mm
        places = everywhere[points.row * self.target.grid_columns + points.column]
        return replace(points, measured_points_target=places)


def estimate_target_shape(
    views: Sequence[GridPoints], *, lens: Lens | None = None, least_directions: int = LEAST_DIRECTIONS
) -> TargetShape:
    """Estimate the shape of the target that all views show, from `least_directions` at least.

    Raises InvalidArgument for no views, several targets or sizes of image, and targets of more than `MOST_POINTS`
    points; TargetShapeNotObservable where the views do not tell the shape; and what `calibrate_views` raises.
    """
    if not views:
        raise InvalidArgument("At least one view is needed.")
    target = views[0].target
    if any(v.target != target for v in views):
        raise InvalidArgument("All views must show the same target.", "Refine one target at a time.")
    if target.size > MOST_POINTS:
        raise InvalidArgument(
            f"The target has {target.size} points; its shape is estimated for up to {MOST_POINTS}.",
            "Use a coarser target where its shape matters.",
        )
    ideal = [replace(v, measured_points_target=None) for v in views]
    planar = calibrate_views(ideal, lens=lens)
    kept = np.array([i for i, used in enumerate(planar.used) if used.any()])
    rotations = np.array([planar.T_camera_target[i][:3, :3] for i in kept])
    directions = count_directions(rotations)
    if directions < least_directions:
        raise TargetShapeNotObservable(
            f"The images show the target from {directions} directions that differ by 5° and are tilted by 10° or more; "
            f"its shape takes {least_directions}."
        )
    fit = _Fit.of([views[i] for i in kept], lens)
    start = np.array([planar.T_camera_target[i][:3, 3] for i in kept]) + rotations @ fit.middle
    state = ShapeState(planar.camera.as_array(), rotations, start, fit.nominal.copy())
    weights = tuple(np.ones(len(v.place)) for v in fit.views)
    before = _rms_px(fit.views, residuals_at(state, fit.views), tuple(planar.used[i] for i in kept))
    state = fit.robust(state, weights)
    used = _inliers(residuals_at(state, fit.views))
    state, normals, scale = fit.plain(state, used)
    return _conclude(fit, state, normals, scale, used, kept, directions, before)


def count_directions(rotations: Float[np.ndarray, "m 3 3"]) -> int:
    """Return how many of the tilted views R_camera_target differ from one another by more than `APART`."""
    leaders: list[Float[np.ndarray, "3 3"]] = []
    for R in rotations:
        if math.acos(min(abs(float(R[2, 2])), 1.0)) < TILTED:
            continue
        if all(0.5 * (float(np.sum(R * other)) - 1.0) < math.cos(APART) for other in leaders):
            leaders.append(R)
    return len(leaders)


@dataclass(frozen=True, slots=True)
class _Fit:
    """The problem: views over the points that were seen, priors, and what is convention."""

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
        """Return information and gradient of camera and departures, σ per unit of stated uncertainty being `scale`."""
        H, b = normals.information / scale**2, normals.gradient / scale**2
        q, Q = camera_prior(*self.size_px, self.lens, CAMERA)(state.parameters)
        H[:CAMERA, :CAMERA] += Q.T @ Q
        b[:CAMERA] += Q.T @ q
        H[_K3, _K3] += THIRD_RADIAL_PRIOR**-2
        b[_K3] -= state.parameters[_K3] * THIRD_RADIAL_PRIOR**-2
        H[CAMERA:, CAMERA:] += self.prior
        b[CAMERA:] -= self.prior @ (state.points_mm - self.nominal).ravel()
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

        Residuals larger than stated widen all doubt. Smaller ones do not narrow it: corners beside a strong lens's bent
        edges are off alike in all views, which their stated uncertainty has in it, and residuals do not show.
        """
        weights = tuple(u.astype(np.float64) for u in used)
        parameters = CAMERA + 6 * len(self.views) + 3 * len(self.place) - 7
        freedom = max(2 * sum(int(u.sum()) for u in used) - parameters, 1)
        for _ in range(_STEPS):
            squares = _squares(residuals_at(state, self.views), used)
            scale = max(math.sqrt(squares / freedom), 1.0)
            state, length = self.step(state, weights, scale)
            if length < _SETTLED * math.sqrt(parameters):
                normals = normals_at(state, self.views, weights)
                scale = max(math.sqrt(_squares(normals.residuals, used) / freedom), 1.0)
                return state, normals, scale
        raise NotConverged("The target's shape did not settle.", "Add images from more directions.")

    @property
    def least_scale(self) -> float:
        return SMALLEST_NOISE_PX / float(
            np.median(np.concatenate([v.standard_uncertainty_px for v in self.views]))
        )


def _inliers(residuals: Sequence[Float[np.ndarray, "2 _"]]) -> tuple[Bool[np.ndarray, " _"], ...]:
    """Return which points of each view lie within the rejection's distance of that view's median."""
    found = []
    for r in residuals:
        distance = np.hypot(*r)
        found.append(distance <= REJECTION * max(float(np.median(distance)), 1e-3))
    return tuple(found)


def _squares(residuals: Sequence[Float[np.ndarray, "2 _"]], used: Sequence[Bool[np.ndarray, " _"]]) -> float:
    return float(sum(np.sum(r[:, u] ** 2) for r, u in zip(residuals, used, strict=True)))


def _rms_px(
    views: Sequence[SeenPoints],
    residuals: Sequence[Float[np.ndarray, "2 _"]],
    used: Sequence[Bool[np.ndarray, " _"]],
) -> float:
    """Return the root mean square of the residual distances, px."""
    squares = [
        np.sum((r * v.standard_uncertainty_px)[:, u] ** 2)
        for v, r, u in zip(views, residuals, used, strict=True)
    ]
    return math.sqrt(float(sum(squares)) / max(sum(int(u.sum()) for u in used), 1))


def _conclude(
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
    unit = 1.0 / np.sqrt(np.diag(H))
    C = np.linalg.inv(H * np.outer(unit, unit)) * np.outer(unit, unit)
    # H⁻¹ = A⁻¹ + (what the departures' doubt adds), A the camera's information were the target known, and k3 held.
    of_shape = np.zeros((CAMERA, CAMERA))
    by_shape = np.linalg.solve(H[:_K3, :_K3], H[:_K3, CAMERA:])
    of_shape[:_K3, :_K3] = by_shape @ C[CAMERA:, CAMERA:] @ by_shape.T
    gauge = gauge_of(fit.nominal)
    departures = (state.points_mm - fit.nominal).ravel()
    departures = departures - gauge @ (gauge.T @ departures)
    about = C[CAMERA:, CAMERA:]
    covariance = projected(about, gauge)
    # Of a perfect target: what priors hold back does not scatter.
    noise = projected(about - about @ fit.prior @ about, gauge)
    measures = low_order_shapes(fit.nominal, departures, covariance)
    extent = float(np.max(np.ptp(fit.nominal, axis=0)))
    doubt = max(m.standard_uncertainty for m in measures[:3])
    if doubt > LARGEST_BOW_DOUBT * extent:
        raise TargetShapeNotObservable(
            f"The images leave the target's bow uncertain by {doubt:.2g} mm; the limit is "
            f"{LARGEST_BOW_DOUBT * extent:.2g} mm."
        )
    freedom = max(2 * sum(int(u.sum()) for u in used) - CAMERA - 6 * len(kept) - len(departures) + 7, 1)
    return TargetShape(
        target=fit.target,
        column=fit.place % fit.target.grid_columns,
        row=fit.place // fit.target.grid_columns,
        departures_mm=departures.reshape(-1, 3),
        covariance=covariance,
        in_plane=departure_of(departures, covariance, noise, (0, 1)),
        out_of_plane=departure_of(departures, covariance, noise, (2,)),
        bow_x_mm=measures[0],
        bow_y_mm=measures[1],
        twist_mm=measures[2],
        aspect=measures[3],
        shear=measures[4],
        camera=Camera.from_array(state.parameters),
        camera_covariance=C[:CAMERA, :CAMERA],
        shape_covariance=0.5 * (of_shape + of_shape.T),
        used_views=kept,
        doubt_if_turned=_doubt_if_turned(fit, state, H, scale, used),
        directions=directions,
        rms_before_px=before_px,
        rms_px=_rms_px(fit.views, normals.residuals, used),
        reduced_chi2=_squares(normals.residuals, used) / freedom,
    )


def _doubt_if_turned(
    fit: _Fit,
    state: ShapeState,
    information: Float[np.ndarray, "z z"],
    scale: float,
    used: Sequence[Bool[np.ndarray, " _"]],
) -> Float[np.ndarray, "5"]:
    """Return what `TargetShape.doubt_if_turned` is: the information of the same views, turned, comes on top."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = replace(
        state, rotations=quarter @ state.rotations, translations_mm=state.translations_mm @ quarter.T
    )
    more = normals_at(turned, fit.views, [u.astype(np.float64) for u in used]).information / scale**2
    both = information + more
    unit = 1.0 / np.sqrt(np.diag(both))
    C = np.linalg.inv(both * np.outer(unit, unit)) * np.outer(unit, unit)
    covariance = projected(C[CAMERA:, CAMERA:], gauge_of(fit.nominal))
    measures = low_order_shapes(fit.nominal, np.zeros(len(covariance)), covariance)
    return np.array([m.standard_uncertainty for m in measures])
