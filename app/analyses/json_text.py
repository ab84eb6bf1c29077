"""Documents as JSON text, with numbers of as many digits as their use supports.

The rule, which `docs/conventions.md` states for readers:

1. A value with a stated standard uncertainty u is rounded at the fourth decimal place after the first digit of u, so by
   at most u/20,000. Two places would do for one value by itself. Estimates are correlated, though: a combination of
   focal length and distance, or of k1 and k2, may be known a hundred times better than either, and rounding each by its
   own u must not be seen there.
2. Every number has ten significant digits at most. Rotation matrices are then orthogonal to 2e-10, covariances are
   positive semidefinite to 1e-9 of their diagonal, and no length of a metre is off by a nanometre.

Rounding is by decimal places and correct, so that the same value always gives the same text.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

SIGNIFICANT_DIGITS = 10
PLACES_AFTER_UNCERTAINTY = 4
_PARTS = ("intrinsics", "distortion")
"""Objects whose values have their uncertainties in `standard_uncertainty` of the object around them."""
_COORDINATES = ("x_mm", "y_mm", "z_mm")
"""Uncertainties of the three numbers of `position_mm`."""


def encode(document: Mapping[str, Any]) -> bytes:
    """Return a document as JSON, its numbers rounded; raises ValueError for NaN and infinities."""
    return json.dumps(rounded(document), allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode()


def rounded(value: Any) -> Any:
    """Return a value of JSON with its numbers rounded, those with a stated uncertainty to its fourth place."""
    if isinstance(value, float):
        return _to_significant_digits(value)
    if isinstance(value, list | tuple):
        return [rounded(item) for item in value]
    if not isinstance(value, Mapping):
        return value
    found = {name: rounded(item) for name, item in value.items()}
    uncertainty = value.get("standard_uncertainty")
    if isinstance(uncertainty, Mapping):
        _round_to_uncertainty(found, uncertainty)
    return found


def _to_significant_digits(value: float) -> float:
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}") + 0.0  # no -0.0


def _round_to_uncertainty(found: dict[str, Any], uncertainty: Mapping[str, Any]) -> None:
    """Round the values of `found` that `uncertainty` names, in place."""
    holders = [found, *(found[part] for part in _PARTS if isinstance(found.get(part), dict))]
    for name, u in uncertainty.items():
        for holder in holders:
            if isinstance(holder.get(name), float):
                holder[name] = _to_places(holder[name], u)
    position = found.get("position_mm")
    if isinstance(position, list) and uncertainty.keys() >= set(_COORDINATES):
        found["position_mm"] = [
            _to_places(value, uncertainty[name]) for value, name in zip(position, _COORDINATES, strict=True)
        ]


def _to_places(value: float, u: float | None) -> float:
    """Return the value rounded to the fourth place after the first digit of u; as it is where u is 0 or not known."""
    if not u:
        return value
    return round(value, PLACES_AFTER_UNCERTAINTY - math.floor(math.log10(u))) + 0.0
