"""Lengths that a rule read on a print, and the pitches along x and y that follow from them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from core.calibration.target_shape.deformation import Measure
from core.errors import InvalidArgument

_WORST_MISREADING = 0.2


@dataclass(frozen=True, slots=True)
class RuleReading:
    """What a steel rule read along x or y for a length that the print states, mm."""

    along: Literal["x", "y"]
    stated_mm: float
    read_mm: float
    standard_uncertainty_mm: float


def check_asked(readings: Sequence[RuleReading], limit: float) -> None:
    """Raise InvalidArgument for a limit or a reading that cannot be meant.

    `check_print` does so itself; this can be asked before the shape is known, which takes its time.
    """
    if not 0.0 < limit < 1.0:
        raise InvalidArgument(f"The limit must be a share between 0 and 1, got {limit!r}.")
    for reading in readings:
        values = (reading.stated_mm, reading.read_mm, reading.standard_uncertainty_mm)
        if not all(0.0 < value < math.inf for value in values):
            raise InvalidArgument("A rule's readings, stated lengths and their uncertainty must be positive.")
        if abs(reading.read_mm / reading.stated_mm - 1.0) > _WORST_MISREADING:
            raise InvalidArgument(
                f"A rule that reads {reading.read_mm:g} mm for a stated {reading.stated_mm:g} mm along {reading.along} "
                "is no check of this print.",
                "Measure between the marks that the stated length belongs to, in millimetres.",
            )


def pitches_of(
    readings: Sequence[RuleReading], aspect: Measure, stated_mm: float
) -> tuple[Measure, Measure] | None:
    """Return the pitches along x and y (mm) of a print with this aspect (its length along x over that along y, less 1),
    or None without a reading.
    """
    if not readings:
        return None
    rows, values, weights = (
        [[1.0, -1.0]],
        [math.log1p(aspect.value)],
        [aspect.standard_uncertainty],
    )
    for reading in readings:
        rows.append([1.0, 0.0] if reading.along == "x" else [0.0, 1.0])
        values.append(math.log(reading.read_mm / reading.stated_mm))
        weights.append(reading.standard_uncertainty_mm / reading.read_mm)
    A = np.array(rows) / np.array(weights)[:, None]
    C = np.linalg.inv(A.T @ A)
    logs = C @ A.T @ (np.array(values) / np.array(weights))
    pitch = [stated_mm * math.exp(v) for v in logs]
    x, y = (Measure(p, p * math.sqrt(v)) for p, v in zip(pitch, np.diag(C), strict=True))
    return x, y
