"""A target's calibration certificate: where its grid points were measured to lie, and how well."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from core.errors import InvalidTarget


@dataclass(frozen=True, slots=True)
class CertificateUncertainty:
    """Standard uncertainties: of both pitches (mm) and of the squareness (mrad)."""

    pitch_x_mm: float
    pitch_y_mm: float
    squareness_mrad: float = 0.0


@dataclass(frozen=True, slots=True)
class Certificate:
    """What a laboratory measured of one target.

    Either both pitches with their standard uncertainties, and by how many mrad less than 90° the axes meet, or the
    grid points row by row (mm, target frame) with one standard uncertainty along each axis; of both the points count.
    Lengths hold at `temperature_c`; `expansion_per_k` takes them to another temperature.

    Raises InvalidTarget for values that contradict each other or are no lengths.
    """

    number: str | None = None
    laboratory: str | None = None
    issued_on: str | None = None
    temperature_c: float | None = None
    expansion_per_k: float | None = None
    pitch_x_mm: float | None = None
    pitch_y_mm: float | None = None
    squareness_mrad: float | None = None
    standard_uncertainty: CertificateUncertainty | None = None
    points_mm: tuple[tuple[float, float, float], ...] | None = None
    points_standard_uncertainty_mm: float | None = None

    def __post_init__(self) -> None:
        pitches = (self.pitch_x_mm, self.pitch_y_mm)
        if self.points_mm is None and None in pitches:
            raise _invalid("states neither both pitches nor the points")
        if (pitches[0] is None) != (pitches[1] is None):
            raise _invalid("states one pitch of two")
        if self.points_mm is not None and self.points_standard_uncertainty_mm is None:
            raise _invalid("states points without points_standard_uncertainty_mm")
        if self.points_mm is None and self.standard_uncertainty is None:
            raise _invalid("states pitches without standard_uncertainty")
        stated = self.standard_uncertainty
        lengths = [*pitches, self.points_standard_uncertainty_mm]
        lengths += [stated.pitch_x_mm, stated.pitch_y_mm, stated.squareness_mrad] if stated else []
        if any(value is not None and not (math.isfinite(value) and value >= 0.0) for value in lengths):
            raise _invalid("has a length or an uncertainty that is no positive number")
        if (self.expansion_per_k is None) != (self.temperature_c is None):
            raise _invalid("states temperature_c and expansion_per_k, or neither: one alone is of no use")

    @classmethod
    def of(cls, fields: Mapping[str, Any]) -> Certificate:
        """Return the certificate with these fields, as JSON has them."""
        values = dict(fields)
        if values.get("standard_uncertainty") is not None:
            values["standard_uncertainty"] = CertificateUncertainty(**values["standard_uncertainty"])
        if values.get("points_mm") is not None:
            values["points_mm"] = tuple(tuple(float(v) for v in point) for point in values["points_mm"])
        return cls(**values)

    def at_temperature(self, temperature_c: float) -> Certificate:
        """Return the certificate with lengths at another temperature; as it is where it states no expansion."""
        if self.temperature_c is None or self.expansion_per_k is None:
            return self
        factor = 1.0 + self.expansion_per_k * (temperature_c - self.temperature_c)
        points = self.points_mm
        return replace(
            self,
            temperature_c=temperature_c,
            pitch_x_mm=None if self.pitch_x_mm is None else factor * self.pitch_x_mm,
            pitch_y_mm=None if self.pitch_y_mm is None else factor * self.pitch_y_mm,
            points_mm=None
            if points is None
            else tuple((factor * x, factor * y, factor * z) for x, y, z in points),
        )

    def places(self, ideal: Float[np.ndarray, "n 3"], pitch_mm: float) -> Float[np.ndarray, "n 3"]:
        """Return all grid points of a target, row by row, from the ideal ones at its nominal pitch."""
        if self.points_mm is not None:
            return np.array(self.points_mm, dtype=np.float64)
        assert self.pitch_x_mm is not None  # checked on entry
        assert self.pitch_y_mm is not None
        x = ideal[:, 0] * self.pitch_x_mm / pitch_mm
        y = ideal[:, 1] * self.pitch_y_mm / pitch_mm
        return np.column_stack([x + 1e-3 * (self.squareness_mrad or 0.0) * y, y, ideal[:, 2]])


def _invalid(what: str) -> InvalidTarget:
    return InvalidTarget(
        f"The certificate {what}.",
        "State pitch_x_mm, pitch_y_mm and standard_uncertainty, or points_mm and points_standard_uncertainty_mm.",
        field="certificate",
    )
