"""Deviations of a target's points from their nominal places: low-order shapes, gauge, and uncertainty.

Vectors have x, y, z of one point after another, mm; points are about the target's middle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtrc

from core.errors import InvalidArgument
from core.geometry import AnyCamera
from core.targets import GridPoints, TargetSpec

POINT_PRIOR = 0.02  # of the pitch, each coordinate
BOW_PRIOR = 0.02  # of the extent, at the border
AFFINE_PRIOR = 0.01
SIGNIFICANT = 1e-3


@dataclass(frozen=True, slots=True)
class Deformation:
    """How far points are from their places, over all points and the coordinates meant; mm.

    `rms_mm` with its standard uncertainty, `noise_mm` the rms that the estimate's own uncertainty makes of it, `chi2`
    and `freedom` of the deviations against what noise alone would give, `significant` where that explains them once
    in a thousand times at most.
    """

    rms_mm: float
    standard_uncertainty_mm: float
    noise_mm: float
    largest_mm: float
    chi2: float
    freedom: int
    significant: bool


@dataclass(frozen=True, slots=True)
class Measure:
    """A number with its standard uncertainty, in one unit."""

    value: float
    standard_uncertainty: float


@dataclass(frozen=True, slots=True)
class TargetShape:
    """Measured shape of a target. Arrays run over the n points that were seen, row-major.

    `deviations_mm` in the target frame (x, y, z; z into the board), `covariance` (3 n, 3 n) in mm², x, y, z of one
    point after another. Of the quadratic that fits best, `bow_x_mm` is how far the middle of a row stands out along z
    from the line between its ends, `bow_y_mm` the same of a column, `twist_mm` how far the corners stand out of the
    plane, two up and two down. `aspect` is the length along x over that along y, less 1; `shear` by how much less
    than 90° the axes meet, rad. `camera` and `camera_covariance` are those of the joint fit: the uncertainty of the
    target's shape is in them, by `shape_covariance`. `used_views` are the views that count, by their index.
    `single_direction_uncertainty` is what the standard uncertainties of bows, twist, aspect and shear would be, had
    every view been taken once more with the camera turned by 90° about its axis: that separates the print's aspect
    from the aspect of the camera's pixels.
    """

    target: TargetSpec
    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    deviations_mm: Float[np.ndarray, "n 3"]
    covariance: Float[np.ndarray, "p p"]
    in_plane: Deformation
    out_of_plane: Deformation
    bow_x_mm: Measure
    bow_y_mm: Measure
    twist_mm: Measure
    aspect: Measure
    shear: Measure
    camera: AnyCamera
    camera_covariance: Float[np.ndarray, "s s"]
    shape_covariance: Float[np.ndarray, "s s"]
    used_views: Int[np.ndarray, " k"]
    single_direction_uncertainty: Float[np.ndarray, "5"]
    directions: int
    rms_before_px: float
    rms_px: float
    reduced_chi2: float

    @property
    def standard_uncertainty_mm(self) -> Float[np.ndarray, "n 3"]:
        """Standard uncertainty of each deviation."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0)).reshape(-1, 3)

    def applied(self, points: GridPoints) -> GridPoints:
        """Return the same points with their measured places on this target in place of the nominal ones."""
        if points.target != self.target:
            raise InvalidArgument("These points are another target's.")
        everywhere = self.target.points_target()
        everywhere[self.row * self.target.grid_columns + self.column] += self.deviations_mm
        places = everywhere[points.row * self.target.grid_columns + points.column]
        return replace(points, measured_points_target=places)


def shape_prior(nominal: Float[np.ndarray, "n 3"], pitch_mm: float) -> Float[np.ndarray, "p p"]:
    """Return the prior information on the deviations, by Woodbury from the sum of its parts."""
    modes = np.column_stack(
        [BOW_PRIOR * m for m in _bows(nominal)] + [AFFINE_PRIOR * m for m in _affine(nominal)]
    )
    inverse = 1.0 / (POINT_PRIOR * pitch_mm) ** 2
    inside = np.linalg.inv(np.eye(modes.shape[1]) + inverse * modes.T @ modes)
    return np.asarray(inverse * np.eye(len(modes)) - inverse**2 * modes @ inside @ modes.T)


def _bows(nominal: Float[np.ndarray, "n 3"]) -> list[Float[np.ndarray, " p"]]:
    """Return z = x²/h, y²/h and xy/h with h the extent, as deviations of all points; as high as the extent at most."""
    x, y = nominal[:, 0], nominal[:, 1]
    extent = float(np.max(np.ptp(nominal, axis=0)))
    nothing = np.zeros(len(x))
    return [np.column_stack([nothing, nothing, 4.0 * z / extent]).ravel() for z in (x * x, y * y, x * y)]


def _affine(nominal: Float[np.ndarray, "n 3"]) -> list[Float[np.ndarray, " p"]]:
    """Return a print longer in x than in y, and one whose axes meet at less than 90°, for a ratio and an angle of 1."""
    x, y = 0.5 * nominal[:, 0], 0.5 * nominal[:, 1]
    nothing = np.zeros(len(x))
    return [np.column_stack([x, -y, nothing]).ravel(), np.column_stack([y, x, nothing]).ravel()]


def gauge_of(nominal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "p 7"]:
    """Return an orthonormal basis of what moves, turns and scales the target as a whole."""
    count = len(nominal)
    moves = [np.tile(axis, (count, 1)) for axis in np.eye(3)]
    turns = [np.cross(axis, nominal) for axis in np.eye(3)]
    basis, _ = np.linalg.qr(np.column_stack([m.ravel() for m in (*moves, *turns, nominal)]))
    return np.asarray(basis)


def projected(
    covariance: Float[np.ndarray, "p p"], gauge: Float[np.ndarray, "p 7"]
) -> Float[np.ndarray, "p p"]:
    """Return the covariance of what is left when the gauge's part is taken off."""
    half = covariance - gauge @ (gauge.T @ covariance)
    result = half - (half @ gauge) @ gauge.T
    return np.asarray(0.5 * (result + result.T))


def low_order_shapes(
    nominal: Float[np.ndarray, "n 3"],
    deviations: Float[np.ndarray, " p"],
    covariance: Float[np.ndarray, "p p"],
) -> list[Measure]:
    """Fit the low-order shapes together with the gauge freedoms; return their sizes."""
    extent = float(np.max(np.ptp(nominal, axis=0)))
    half = 0.5 * np.ptp(nominal, axis=0)
    # By z = 4 a x² / extent the middle of a row lies 4 a (half)² / extent off the line between its ends.
    height = 4.0 / extent * np.array([half[0] ** 2, half[1] ** 2, half[0] * half[1]])
    modes = np.column_stack([*_bows(nominal), *_affine(nominal), gauge_of(nominal)])
    by_deviation = np.linalg.pinv(modes)[:5]
    by_deviation[:3] *= height[:, None]
    values = by_deviation @ deviations
    uncertainty = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", by_deviation, covariance, by_deviation), 0.0))
    # A positive bow stands out toward +z in the middle, where x² bends the ends.
    signs = np.array([-1.0, -1.0, 1.0, 1.0, 1.0])
    return [Measure(float(s * v), float(u)) for s, v, u in zip(signs, values, uncertainty, strict=True)]


def without_low_order(
    nominal: Float[np.ndarray, "n 3"], deviations: Float[np.ndarray, " p"]
) -> Float[np.ndarray, "n 3"]:
    """Return what the low-order shapes and the gauge leave of deviations, by least squares."""
    modes = np.column_stack([*_bows(nominal), *_affine(nominal), gauge_of(nominal)])
    rest = deviations - modes @ np.linalg.lstsq(modes, deviations, rcond=None)[0]
    return np.asarray(rest.reshape(-1, 3))


def summarise_deviations(
    deviations: Float[np.ndarray, " p"],
    covariance: Float[np.ndarray, "p p"],
    noise: Float[np.ndarray, "p p"],
    axes: tuple[int, ...],
) -> Deformation:
    count = len(deviations) // 3
    chosen = (3 * np.arange(count)[:, None] + np.array(axes)).ravel()
    d, C = deviations[chosen], covariance[np.ix_(chosen, chosen)]
    rms = math.sqrt(float(d @ d) / count)
    # Var |d|² = 4 dᵀ C d + 2 tr C² about a deviation d.
    variance = 4.0 * float(d @ C @ d) + 2.0 * float(np.sum(C * C))
    values, vectors = np.linalg.eigh(noise[np.ix_(chosen, chosen)])
    determined = values > 1e-9 * values[-1]
    along = vectors[:, determined].T @ d
    chi2, freedom = float(np.sum(along**2 / values[determined])), int(determined.sum())
    return Deformation(
        rms_mm=rms,
        standard_uncertainty_mm=math.sqrt(variance) / (2.0 * count * rms) if rms > 0.0 else 0.0,
        noise_mm=math.sqrt(float(np.trace(C)) / count),
        largest_mm=math.sqrt(float(np.max(np.sum(d.reshape(count, -1) ** 2, axis=1)))),
        chi2=chi2,
        freedom=freedom,
        significant=float(chdtrc(freedom, chi2)) < SIGNIFICANT,
    )
