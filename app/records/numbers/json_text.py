"""Documents as JSON text, with numbers of as many digits as their use supports.

The rule, which `docs/conventions.md` states for readers:

1. A value with a stated standard uncertainty u is rounded at the fourth decimal place after the first digit of u, so by
   at most u/20,000. Two places would do for one value by itself. Estimates are correlated, though: a combination of
   focal length and distance, or of k1 and k2, may be known a hundred times better than either, and rounding each by its
   own u must not be seen there. So is the mean of values with a stated standard deviation.
2. An interval's ends, and the values that it belongs to, are rounded in the same way by its width; two significant
   digits of each are left, so that a lower end far below the width does not become 0. A noise floor next to them is a
   statistic of its own.
3. Uncertainties and standard deviations have four significant digits, statistics have six (`field_names`).
4. Every other number has ten significant digits at most. Rotation matrices are then orthogonal to 2e-10, covariances
   are positive semidefinite to 1e-9 of their diagonal, and no length of a metre is off by a nanometre.

What is answered is rounded by all of them. Records that are compared with what is computed anew, such as reports, are
rounded by `standard_uncertainty` and by 4 alone (`encode_record`): a last digit that falls the other way on
another machine is then far below what a comparison looks for.

Rounding is by decimal places and correct, so that the same value always gives the same text.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from app.records.numbers.field_names import ALL_DIGITS, UNCERTAINTY_DIGITS, belongs, digits_of, is_interval

PLACES_AFTER_UNCERTAINTY = 4
KEPT_DIGITS = 2
NOTHING = 1e-9
"""Of an interval's width: less is what the computation leaves of 0."""
_OWN_SIZE = "noise_floor"
_PARTS = ("intrinsics", "distortion")
"""Objects whose values have their uncertainties in `standard_uncertainty` of the object around them."""
_COORDINATES = ("x_mm", "y_mm", "z_mm")
"""Uncertainties of the three numbers of `position_mm`."""
_REPEATABILITIES = {
    "position_mm": ("rp_x_mm", "rp_y_mm", "rp_z_mm"),
    **{f"{angle}_deg": f"rp_{angle}_deg" for angle in ("roll", "pitch", "yaw")},
}
"""Figures that stand for the uncertainties of a mean pose, which are smaller."""
_ENDS = ("low", "high")
_WITHIN_ENDS = (*_ENDS, "value", "centre")
Json = dict[str, Any]
_NOT_ROUNDED = frozenset({str, int, bool, type(None)})
"""Types that most fields of most documents have, recognised before anything is called."""


def encode(document: Mapping[str, Any]) -> bytes:
    """Return a document as JSON, its numbers rounded; raises ValueError for NaN and infinities."""
    return _text(rounded(document))


def encode_record(document: Mapping[str, Any]) -> bytes:
    """Return a document as JSON that is compared with another one later; raises ValueError for NaN and infinities."""
    return _text(_recorded(document))


def rounded(value: Any, name: str = "") -> Any:
    """Return a value of JSON with its numbers rounded; `name` is its field's."""
    found = _rounded(value, digits_of(name))
    if isinstance(value, Mapping):
        _repeat_figures(found, value)
    return found


def _text(document: Any) -> bytes:
    return json.dumps(document, allow_nan=False, ensure_ascii=False, separators=(",", ":")).encode()


def _recorded(value: Any) -> Any:
    if isinstance(value, float):
        return _to_digits(value, ALL_DIGITS)
    if isinstance(value, list | tuple):
        return [_recorded(item) for item in value]
    if not isinstance(value, Mapping):
        return value
    found = {name: _recorded(item) for name, item in value.items()}
    _round_by_names(found, value, "standard_uncertainty")
    return found


def _rounded(value: Any, digits: int) -> Any:
    if isinstance(value, float):
        return _to_digits(value, digits)
    if isinstance(value, list | tuple):
        return [_rounded(item, digits) for item in value]
    if not isinstance(value, Mapping):
        return value
    found = {
        name: item if type(item) in _NOT_ROUNDED else _field(name, item, digits)
        for name, item in value.items()
    }
    _round_by_intervals(found, value)
    _round_mean(found, value)
    _round_by_neighbours(found, value)
    for name in ("standard_deviation", "standard_uncertainty"):
        _round_by_names(found, value, name)
    return found


def _field(name: str, value: Any, digits: int) -> Any:
    if is_interval(name):
        return _interval(value)
    return _rounded(value, min(digits, digits_of(name)))


def _interval(value: Any) -> Any:
    """Return an interval, or an object or list of intervals, with the ends rounded by the width."""
    width = _width(value)
    if width is not None:
        return [_to_places(end, width, KEPT_DIGITS) for end in value]
    if isinstance(value, Mapping):
        return {name: _interval(item) for name, item in value.items()}
    if isinstance(value, list | tuple) and not all(isinstance(item, float | None) for item in value):
        return [_interval(item) for item in value]
    return _rounded(value, digits_of("value"))


def _width(value: Any) -> float | None:
    """Return the width of an interval; None where it is not one, or has one end alone."""
    if not isinstance(value, list | tuple) or len(value) != len(_ENDS):
        return None
    low, high = value
    return abs(high - low) if isinstance(low, float) and isinstance(high, float) else None


def _round_by_intervals(found: Json, exact: Mapping[str, Any]) -> None:
    """Round the values of objects that have intervals by the same names around or within them."""
    for field in ("interval_95", "interval"):
        widths = exact.get(field)
        if isinstance(widths, Mapping):
            for holder, values in _holders(found, exact):
                for name in widths.keys() & values.keys():
                    _round(holder, values, name, _width(widths[name]), KEPT_DIGITS)
    if all(isinstance(exact.get(end), float) for end in _ENDS):
        width = abs(exact["high"] - exact["low"])
        for name in _WITHIN_ENDS:
            _round(found, exact, name, width, KEPT_DIGITS)


def _round_mean(found: Json, exact: Mapping[str, Any]) -> None:
    """Round a mean pose by the repeatability next to it."""
    mean, repeatability = exact.get("mean"), exact.get("repeatability")
    if isinstance(mean, Mapping) and isinstance(repeatability, Mapping):
        for name, figures in _REPEATABILITIES.items():
            u = (
                [repeatability.get(one) for one in figures]
                if isinstance(figures, tuple)
                else repeatability.get(figures)
            )
            _round(found["mean"], mean, name, u)


def _repeat_figures(found: Json, exact: Mapping[str, Any]) -> None:
    """Give `worst_rp_l_mm` and the like, and the values of a budget's figures, the digits of what they repeat."""
    repeated = []
    for holder, values in ((found, exact), *((found[name], exact[name]) for name in exact)):
        pairs = zip(holder, values, strict=True) if isinstance(values, list) else [(holder, values)]
        for one, each in pairs:
            if isinstance(each, Mapping):
                repeated += [(one, name, (figure, each[name])) for name, figure in _repeats(each)]
    if repeated:
        shown: dict[tuple[str, float], Any] = {}
        _gather(found, exact, {figure for _, _, (figure, _) in repeated}, shown)
        for holder, name, figure in repeated:
            holder[name] = shown.get(figure, holder[name])


def _repeats(values: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the fields of an object that repeat a figure, and that figure's name."""
    named = {name: name.removeprefix("worst_") for name in values if name.startswith("worst_")}
    if isinstance(values.get("figure"), str):
        named["value_mm"] = values["figure"].rpartition(".")[2]
    yield from ((name, figure) for name, figure in named.items() if isinstance(values.get(name), float))


def _gather(found: Any, exact: Any, names: Collection[str], shown: dict[tuple[str, float], Any]) -> None:
    """Note the figures of these names as they are shown, by their exact values; the first of each."""
    if isinstance(exact, dict):
        for name, value in exact.items():
            if name in names and isinstance(value, float):
                shown.setdefault((name, value), found[name])
            elif isinstance(value, dict | list | tuple):
                _gather(found[name], value, names, shown)
    elif isinstance(exact, list | tuple) and exact and isinstance(exact[0], dict | list | tuple):
        for one, value in zip(found, exact, strict=True):
            _gather(one, value, names, shown)


def _holders(found: Json, exact: Mapping[str, Any]) -> Iterator[tuple[Json, Mapping[str, Any]]]:
    yield found, exact
    for name, item in exact.items():
        if (
            isinstance(item, Mapping)
            and name != _OWN_SIZE
            and not is_interval(name)
            and digits_of(name) != UNCERTAINTY_DIGITS
        ):
            yield found[name], item


def _round_by_neighbours(found: Json, exact: Mapping[str, Any]) -> None:
    """Round values by the uncertainty or interval in a field next to them, uncertainties last: they are finer."""
    stated = [name for name, item in exact.items() if item is not None and _is_stated(name)]
    for name in sorted(stated, key=lambda name: not is_interval(name)):
        item = exact[name]
        u = _width(item) if is_interval(name) else item
        for other in exact:
            if belongs(other, name):
                _round(found, exact, other, u, KEPT_DIGITS if is_interval(name) else 0)


def _is_stated(name: str) -> bool:
    return "interval" in name or "standard_uncertainty_" in name


def _round_by_names(found: Json, exact: Mapping[str, Any], field: str) -> None:
    """Round the values that an object of uncertainties names."""
    uncertainty = exact.get(field)
    if not isinstance(uncertainty, Mapping):
        return
    holders = [
        (found, exact),
        *((found[part], exact[part]) for part in _PARTS if isinstance(exact.get(part), Mapping)),
    ]
    for name, u in uncertainty.items():
        for holder, values in holders:
            _round(holder, values, name, u)
    if uncertainty.keys() >= set(_COORDINATES):
        _round(found, exact, "position_mm", [uncertainty[name] for name in _COORDINATES])


def _round(found: Json, exact: Mapping[str, Any], name: str, u: Any, kept: int = 0) -> None:
    """Round one number or a list, by one uncertainty or a list, in place; as it is where no u is known."""
    value = exact.get(name)
    us = [
        each for each in (u if isinstance(u, list | tuple) else [u]) if isinstance(each, float) and each > 0.0
    ]
    if not us:
        return
    if isinstance(value, float):
        found[name] = _to_places(value, min(us), kept)
    elif isinstance(value, list | tuple) and value and all(isinstance(item, float) for item in value):
        each = u if isinstance(u, list | tuple) and len(u) == len(value) else [min(us)] * len(value)
        found[name] = [_to_places(item, one, kept) for item, one in zip(value, each, strict=True)]


def _to_digits(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}") + 0.0  # no -0.0


def _to_places(value: float, u: float | None, kept: int = 0) -> float:
    """Return the value rounded to the fourth place after the first digit of u; as it is where u is 0 or not known.

    So many significant digits of its own are `kept`, unless it is nothing next to u.
    """
    value = _to_digits(value, ALL_DIGITS)
    if not u:
        return value
    u = _to_digits(u, UNCERTAINTY_DIGITS)  # as it is shown, so that what is rounded stays as it is
    places = PLACES_AFTER_UNCERTAINTY - math.floor(math.log10(u))
    if kept and abs(value) > NOTHING * u:
        places = max(places, kept - 1 - math.floor(math.log10(abs(value))))
    return round(value, places) + 0.0
