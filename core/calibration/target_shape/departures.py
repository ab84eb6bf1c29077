"""Departures of a print as nuisance parameters: fields over its grid points, with prior standard uncertainties.

Fields are about the middle of the grid, with ξ = x / half width and η = y / half height. What moves the grid as a
whole needs no care: all poses shift by the same motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.targets import PRINT_KINDS, ShapeUncertainty, TargetSpec

SENSOR_SKEW = 1e-5
"""Standard uncertainty of the angle of a sensor's rows and columns, rad."""
MAX_POINTS = 700
"""Grid points up to which each has a departure of its own. Of more points, their mean effect on a pose is small."""
SCALE = "scale"
LENS, PRINT_SCALE, PRINT_SHAPE = "lens", "print_scale", "print_shape"
"""Sources of the errors that all poses share."""


@dataclass(frozen=True, slots=True)
class ShapePrior:
    """What is known of one print before its images: `shape`, and the relative standard uncertainty of its scale; None
    where it is not stated. Of a `certified` print both pitches are known, so that its aspect says nothing more of its
    scale.
    """

    shape: ShapeUncertainty
    scale: float | None
    certified: bool = False

    @classmethod
    def of(cls, target: TargetSpec) -> ShapePrior:
        """Return what a target states, or what its kind of print lets expect."""
        shape = target.shape_standard_uncertainty or PRINT_KINDS[target.print_kind or "paper"]
        certificate = target.certificate
        if certificate is None:
            return cls(shape, target.scale_standard_uncertainty)
        if certificate.points_mm is not None:
            u = certificate.points_standard_uncertainty_mm or 0.0
            half = 0.5 * float(np.max(np.ptp(np.array(certificate.points_mm), axis=0)))
            return cls(
                ShapeUncertainty(u / half, u / half, u, u, u, u), target.scale_standard_uncertainty, True
            )
        assert certificate.standard_uncertainty is not None  # of pitches there is one
        known = certificate.standard_uncertainty
        return cls(
            replace(
                shape,
                aspect=math.hypot(known.pitch_x_mm, known.pitch_y_mm) / target.pitch_mm,
                shear=1e-3 * known.squareness_mrad,
            ),
            target.scale_standard_uncertainty,
            True,
        )


@dataclass(frozen=True, slots=True)
class Departures:
    """Fields (k, 3, n) of a print's n grid points, mm per standard uncertainty, by `names`; `point_mm` is that of each
    point along x and y, 0 where points have no departure of their own.

    Parameters of the fields have unit prior variance. `aspect` is the aspect per standard uncertainty.
    """

    names: tuple[str, ...]
    fields: Float[np.ndarray, "k 3 n"]
    point_mm: float
    aspect: float
    certified: bool

    @classmethod
    def of(cls, target: TargetSpec, prior: ShapePrior) -> Departures:
        points = target.points_target()
        x, y = (points[:, :2] - 0.5 * (points[:, :2].min(axis=0) + points[:, :2].max(axis=0))).T
        xi, eta = x / max(float(np.max(np.abs(x))), 1e-9), y / max(float(np.max(np.abs(y))), 1e-9)
        none = np.zeros(len(x))
        shape = prior.shape
        found = [
            ("aspect", 0.5 * shape.aspect * np.array([x, -y, none])),
            ("shear", 0.5 * shape.shear * np.array([y, x, none])),
            ("bow_x", shape.bow_mm * np.array([none, none, xi * xi])),
            ("bow_y", shape.bow_mm * np.array([none, none, eta * eta])),
            ("twist", shape.twist_mm * np.array([none, none, xi * eta])),
        ]
        for form, values in (("xx", xi * xi), ("xy", xi * eta), ("yy", eta * eta)):
            found.append((f"x_{form}", shape.quadratic_mm * np.array([values, none, none])))
            found.append((f"y_{form}", shape.quadratic_mm * np.array([none, values, none])))
        if prior.scale is not None:
            found.append((SCALE, prior.scale * np.array([x, y, none])))
        kept = [(name, field) for name, field in found if np.any(field != 0.0)]
        return cls(
            tuple(name for name, _ in kept),
            np.array([field for _, field in kept]).reshape(-1, 3, len(x)),
            shape.point_mm if target.size <= MAX_POINTS else 0.0,
            shape.aspect,
            prior.certified,
        )

    def sources(self) -> list[str]:
        """Return what each parameter is of: the fields', then two for each point where points have any."""
        of_fields = [PRINT_SCALE if name == SCALE else PRINT_SHAPE for name in self.names]
        return of_fields + [PRINT_SHAPE] * (2 * self.fields.shape[2] if self.point_mm > 0.0 else 0)

    def scale_left(self, aspect: float, aspect_uncertainty: float) -> float:
        """Return the relative uncertainty of scale that goes with the aspect found: a print that is off along one axis
        is off in its mean by half as much, u² = max(a² - u_a², 0)/4 + u_a²/4.
        """
        return 0.5 * math.sqrt(max(aspect**2 - aspect_uncertainty**2, 0.0) + aspect_uncertainty**2)


def mirrored(
    N: Float[np.ndarray, "q q"], head: int, first: Sequence[int], departures: Sequence[Departures]
) -> Float[np.ndarray, "q q"]:
    """Return N with the points' rows, which were summed, written into their columns as well."""
    for begin, found in zip(first, departures, strict=True):
        low = len(found.names)
        if found.point_mm > 0.0:
            rows = slice(begin + low, begin + low + 2 * found.fields.shape[2])
            N[:head, rows] = N[rows, :head].T
            N[begin : begin + low, rows] = N[rows, begin : begin + low].T
    return N
