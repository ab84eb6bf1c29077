"""The uncertainty of an instrument, stated once for all of its readings."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from ... import Json
from ..record_files import FileRefused

_FORM = re.compile(r"(?P<constant>[0-9.]+)(\+(?P<per_m>[0-9.]+))?")
_MM_PER_M = 1000.0


@dataclass(frozen=True, slots=True)
class Instrument:
    """Standard uncertainty of each coordinate: `constant_mm` and `mm_per_m` for each metre from the instrument."""

    constant_mm: float
    mm_per_m: float = 0.0

    def at(self, position_mm: Sequence[float]) -> float:
        """Return the standard uncertainty of a point's coordinates, mm."""
        return self.constant_mm + self.mm_per_m * math.hypot(*position_mm) / _MM_PER_M


def parse_instrument(text: str) -> Instrument:
    """Return what `A` or `A+B` states, in mm and mm per m. Raises FileRefused."""
    match = _FORM.fullmatch(text.replace(" ", ""))
    try:
        constant, per_m = (
            float(match["constant"]) if match else math.nan,
            float((match and match["per_m"]) or 0.0),
        )
    except ValueError:
        constant = per_m = math.nan
    if not constant + per_m > 0.0:
        raise FileRefused(
            f"--instrument-uncertainty {text} is no uncertainty.",
            "Write the standard uncertainty of a coordinate in mm, and what it grows by per metre, e.g. 0.0075+0.003.",
        )
    return Instrument(constant, per_m)


def with_uncertainty(pose: Json, instrument: Instrument) -> Json:
    """Return a reading with the instrument's covariance, where it has none and states a position alone."""
    if pose.get("covariance") is not None or pose.get("rotation") is not None:
        return pose
    variance = instrument.at(pose["position_mm"]) ** 2
    covariance = [[variance if i == j < 3 else 0.0 for j in range(6)] for i in range(6)]
    return {**pose, "covariance": covariance}
