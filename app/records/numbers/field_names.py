"""What the names of documents' fields say of their numbers: how many digits, whose uncertainty, whose interval.

A field that is no uncertainty, no statistic and has neither next to it is an estimate, an input or a matrix.
"""

from __future__ import annotations

import re
from functools import lru_cache

DH_PARAMETERS = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg", "beta_deg")
"""Fields of a joint's Denavit-Hartenberg parameters, in their order."""
ALL_DIGITS = 10
STATISTIC_DIGITS = 6
UNCERTAINTY_DIGITS = 4
_UNCERTAINTIES = frozenset({"uncertainty", "uncertainties", "sigma", "std"})
_UNCERTAINTY_NAMES = frozenset({"largest_covered_px", "largest_blank_px"})
_STATISTICS = frozenset(
    {
        *("rms", "residual", "residuals", "reprojection", "chi2", "validation", "value", "probability"),
        *("statistic", "share", "fraction", "ratio", "evidence", "freedom", "factor", "condition"),
        *("observability", "indices", "autocorrelation", "likelihood", "quality", "scatter", "noise", "log"),
        *("rp", "ap", "rd", "ad", "drp", "dap", "vap", "ewma", "duration", "distance", "variation", "tilt"),
        *("worst", "largest", "median", "least", "uncorrected", "difference", "deviation", "sensitivity"),
    }
)
_STATISTIC_NAMES = frozenset(
    {"mean_px", "max_px", "contrast", "edge_width_px", "motion_blur_px", "scale_ppm", "effective_cycles"}
    | {"first", "last", "before", "after", "change_mm", "step_mm"}
)
_STATED = frozenset({"datasheet", "permissible", "commanded", "nominal", "length"})
"""Words of fields that say what somebody stated: answered as it came."""
_PLACES = frozenset({"place", "map", "poses", "points"})
"""Words of objects that have a statistic's name and hold more than statistics."""
_HOLDERS = frozenset({"projection_uncertainty"})
_UNCERTAINTY = re.compile(r"(?:(?P<prefix>[a-z0-9_]+)_)?standard_uncertainty_(?P<unit>[a-z_]+)")
_INTERVAL = re.compile(r"(?:(?P<prefix>[a-z0-9_]+)_)?interval(?:_(?P<unit>[a-z]+))?")


@lru_cache(maxsize=4096)
def digits_of(name: str) -> int:
    """Return how many significant digits a field's numbers have, those of the objects and lists in it included."""
    if name in _HOLDERS:
        return ALL_DIGITS
    words = frozenset(name.split("_"))
    if (
        words & _UNCERTAINTIES
        or name in _UNCERTAINTY_NAMES
        or "standard_deviation" in name
        or "standard_error" in name
    ):
        return UNCERTAINTY_DIGITS
    if words & _STATED or words & _PLACES:
        return ALL_DIGITS
    return STATISTIC_DIGITS if words & _STATISTICS or name in _STATISTIC_NAMES else ALL_DIGITS


@lru_cache(maxsize=4096)
def is_interval(name: str) -> bool:
    """Return whether a field holds an interval, or an object of intervals."""
    return "interval" in name.split("_")


@lru_cache(maxsize=4096)
def belongs(name: str, stated: str) -> bool:
    """Return whether the uncertainty or interval of the field `stated` is that of the number `name` next to it.

    `step_standard_uncertainty_mm` is that of `step_mm` and `step_distance_mm`, `ad_interval_mm` of `ad_mm`,
    `ratio_interval` of `ratio`; `standard_uncertainty_mm` and `interval_mm` are those of all in mm.
    """
    if digits_of(name) == UNCERTAINTY_DIGITS or is_interval(name) or _STATED & set(name.split("_")):
        return False
    found = _UNCERTAINTY.fullmatch(stated) or _INTERVAL.fullmatch(stated)
    if found is None or not (found["prefix"] or found["unit"]):
        return False
    prefix, unit = found["prefix"] or "", found["unit"] or ""
    rest = name.removesuffix(f"_{unit}") if unit else name
    if unit and rest == name:
        return False
    return not prefix or rest == prefix or rest.startswith(f"{prefix}_")
