"""Uncertainties of a target's pitch that are almost surely in micrometres: as large as what they are of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from app.services.plausibility.stated_values import implausible

MAX_PITCH_SHARE = 0.05
"""Of the pitch: a rule held to the sheet says more."""


def check_pitch_uncertainty(
    pitch_mm: float, uncertainty_mm: float | None, certificate: Mapping[str, Any] | None
) -> None:
    """Raise InvalidContent (`implausible_unit`) for a standard uncertainty of more than a twentieth of the pitch: the
    target's own, or one of its certificate's.
    """
    found = certificate or {}
    of_pitches = found.get("standard_uncertainty") or {}
    stated = [
        ("pitch_standard_uncertainty_mm", uncertainty_mm),
        *(
            (f"certificate.standard_uncertainty.{name}", of_pitches.get(name))
            for name in ("pitch_x_mm", "pitch_y_mm")
        ),
        ("certificate.points_standard_uncertainty_mm", found.get("points_standard_uncertainty_mm")),
    ]
    large = [
        (field, f"{value:g} mm would be {0.001 * value:g} mm if it was stated in micrometres")
        for field, value in stated
        if value is not None and value > MAX_PITCH_SHARE * pitch_mm
    ]
    if large:
        raise implausible("micrometres", large, why=f", and the pitch is {pitch_mm:g} mm")
