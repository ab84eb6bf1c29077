"""Priors of the terms: their variances from a few hyperparameters, and those hyperparameters' own priors.

A curve's coefficients of harmonic k have the variance v_k = sa² k⁻⁴ + sb² (1 + (k/k0)²)⁻², a smooth part and a tail as
harmonic drives have. Every hyperparameter is a logarithm; its prior is normal about the defaults, narrow where poses
are few, and wide enough elsewhere for gear arms (no tail) as for harmonic drives (sb near 6 mdeg).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.kinematics.error_model.terms import Kind, Terms

FEW_POSES = 60
LEAST_POSES = 12
"""With fewer poses the hyperparameters keep their defaults."""
_SMOOTH, _TAIL, _CORNER, _COMPLIANCE, _RADIAL, _WOBBLE, _APPROACH = range(7)
_DEFAULTS = (
    math.radians(6e-3),  # sa, rad
    math.radians(1e-3),  # sb, rad
    30.0,  # k0
    0.6e-3,  # compliance, rad per m of lever
    0.3e-3,  # radial compliance, rad per m of lever
    0.015,  # wobble: .015 mm and .015 mrad
    math.radians(3e-3),  # approach, rad: gears without play have less, worn ones ten times as much
)
_MRAD = 1e-3
_CORNER_SPREAD = 0.5


@dataclass(frozen=True, slots=True)
class Hyperparameters:
    """Logarithms of sa² and sb² (rad²), k0, compliance², radial² ((rad/m)²), wobble² (mm² and mrad²)
    and approach² (rad²)."""

    log_values: Float[np.ndarray, "7"]

    @classmethod
    def defaults(cls) -> Hyperparameters:
        """Return those that begin every fit, and are the means of the priors."""
        values = 2.0 * np.log(_DEFAULTS)
        values[_CORNER] *= 0.5
        return cls(values)

    def variances(self, terms: Terms) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, "7 c"]]:
        """Return the variance of every column's coefficient, and its logarithm's derivatives by the hyperparameters."""
        sa, sb, corner, compliance, radial, wobble, approach = np.exp(self.log_values)
        v = np.zeros(len(terms))
        gradient = np.zeros((len(_DEFAULTS), len(terms)))
        curves = terms.of(Kind.CURVE)
        k = terms.harmonic[curves].astype(np.float64)
        shape = 1.0 / (1.0 + (k / corner) ** 2)
        smooth, tail = sa * k**-4.0, sb * shape**2
        v[curves] = smooth + tail
        gradient[_SMOOTH, curves] = smooth / v[curves]
        gradient[_TAIL, curves] = tail / v[curves]
        gradient[_CORNER, curves] = tail * 4.0 * (k / corner) ** 2 * shape / v[curves]
        for at, kind, value in (
            (_COMPLIANCE, Kind.COMPLIANCE, compliance),
            (_COMPLIANCE, Kind.LINK_COMPLIANCE, compliance),
            (_RADIAL, Kind.RADIAL, radial),
            (_WOBBLE, Kind.WOBBLE_TURN, wobble * _MRAD**2),
            (_WOBBLE, Kind.WOBBLE_SHIFT, wobble),
            (_APPROACH, Kind.APPROACH, approach),
        ):
            of_kind = terms.of(kind)
            v[of_kind] = value
            gradient[at, of_kind] = 1.0
        return v, gradient


def spreads(poses: int) -> Float[np.ndarray, "7"]:
    """Return the standard deviations of the hyperparameters' priors for so many distinct poses."""
    of_logarithms = np.full(len(_DEFAULTS), 0.7 if poses < FEW_POSES else 2.0)
    of_logarithms[_CORNER] = _CORNER_SPREAD
    return of_logarithms
