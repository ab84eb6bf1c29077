"""Stored values that cannot be read: found one by one, so that a damaged row is the trouble of nobody else.

A disk, a restored dump or somebody's own SQL can leave in a column what its type does not hold: a time beyond the year
9999, half a JSON document, a text where a number belongs. The drivers raise then, and the whole query with them. Here
such a value reads as `Unreadable`, and `unreadable_columns` names the columns of a row that hold one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from datetime import datetime
from functools import cache
from typing import Any

import sqlalchemy as sa

from app.records.ids import is_id

CODE = "row_unreadable"


class Unreadable:
    """What stands for a stored value that cannot be read; it is never written."""

    __slots__ = ()

    def __repr__(self) -> str:
        return "unreadable"

    def __format__(self, specification: str) -> str:
        return repr(self)


UNREADABLE = Unreadable()


def read_or_mark(read: Callable[[Any], Any], value: Any) -> Any:
    """Return `read(value)`, or UNREADABLE where the type cannot hold the value."""
    try:
        return read(value)
    except (ValueError, TypeError, OverflowError):
        return UNREADABLE


def read_json(text: str | bytes) -> Any:
    """Return a JSON document, or UNREADABLE.

    Raises TypeError for a number, by which SQLAlchemy knows that SQLite has read the document already.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return UNREADABLE


def read_time(text: bytes) -> datetime | Unreadable:
    """Return a time as PostgreSQL writes it in ISO style; UNREADABLE for infinity and years out of 1 to 9999."""
    try:
        return datetime.fromisoformat(text.decode("ascii"))
    except ValueError:
        return UNREADABLE


def unreadable_columns(row: Any) -> tuple[str, ...]:
    """Return the columns of a loaded row whose values its table does not allow; columns not loaded are not read."""
    return unreadable_values(row.__class__, vars(row))


def unreadable_values(table: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the same of a row's values by the columns' names."""
    return tuple(
        name
        for name, nullable, check in _columns(table)
        if name in values and not (nullable if (value := values[name]) is None else check(value))
    )


def is_readable(column: Any, value: Any) -> bool:
    """Return whether its table allows a value read from a column."""
    if value is None:
        return bool(column.nullable)
    return check_of(column)(value)


@cache
def check_of(column: Any) -> Callable[[Any], bool]:
    """Return the check of a value that is not null: does the table of its column allow it?."""
    if column.name in _BY_NAME:
        return _BY_NAME[column.name]
    return next((check for kind, check in _BY_TYPE if isinstance(column.type, kind)), _is_read)


@cache
def _columns(table: Any) -> tuple[tuple[str, bool, Callable[[Any], bool]], ...]:
    """Return each column's name, whether it may be null, and the check of what is not."""
    return tuple(
        (attribute.key, bool(attribute.columns[0].nullable), check_of(attribute.columns[0]))
        for attribute in sa.inspect(table).column_attrs
    )


def _is_read(value: Any) -> bool:
    return not isinstance(value, Unreadable)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int)


def _are_numbers(value: Any) -> bool:
    return isinstance(value, list) and all(_is_number(number) for number in value)


def _are_rows(value: Any) -> bool:
    return isinstance(value, list) and all(_are_numbers(row) for row in value)


def _are_numbers_of(*names: str, optional: tuple[str, ...] = ()) -> Callable[[Any], bool]:
    def check(value: Any) -> bool:
        return (
            isinstance(value, Mapping)
            and set(names) <= set(value) <= {*names, *optional}
            and all(_is_number(number) for number in value.values())
        )

    return check


def _are_joints(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(joint, Mapping)
        and all(_is_number(joint.get(name)) for name in ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg"))
        and ("beta_deg" not in joint or _is_number(joint["beta_deg"]))
        for joint in value
    )


_CERTIFICATE_TEXTS = ("number", "laboratory", "issued_on")
_CERTIFICATE_NUMBERS = (
    *("temperature_c", "expansion_per_k", "pitch_x_mm", "pitch_y_mm", "squareness_mrad"),
    "points_standard_uncertainty_mm",
)


def _is_certificate(value: Any) -> bool:
    known = {*_CERTIFICATE_TEXTS, *_CERTIFICATE_NUMBERS, "standard_uncertainty", "points_mm"}
    if not isinstance(value, Mapping) or not set(value) <= known:
        return False
    stated, points = value.get("standard_uncertainty"), value.get("points_mm")
    return (
        all(isinstance(value.get(name), str | None) for name in _CERTIFICATE_TEXTS)
        and all(value.get(name) is None or _is_number(value[name]) for name in _CERTIFICATE_NUMBERS)
        and (
            stated is None
            or _are_numbers_of("pitch_x_mm", "pitch_y_mm", optional=("squareness_mrad",))(stated)
        )
        and (points is None or (_are_rows(points) and all(len(point) == 3 for point in points)))
    )


def _are_conditions(value: Any) -> bool:
    numbers, texts = ("temperature_c", "load_kg", "speed_percent", "warm_up_min"), ("operator", "notes")
    return (
        isinstance(value, Mapping)
        and set(value) == {*numbers, *texts}
        and all(value[name] is None or _is_number(value[name]) for name in numbers)
        and all(isinstance(value[name], str | None) for name in texts)
    )


def _is_exclusion(value: Any) -> bool:
    return (
        isinstance(value, Mapping)
        and set(value) == {"reason", "by", "at"}
        and isinstance(value["reason"], str)
        and isinstance(value["by"], str | None)
        and isinstance(value["at"], str)
    )


def _are_signatories(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(one, Mapping)
        and set(one) == {"name", "role"}
        and isinstance(one["name"], str)
        and isinstance(one["role"], str | None)
        for one in value
    )


def _is_report_failure(value: Any) -> bool:
    return (
        isinstance(value, Mapping)
        and set(value) == {"code", "detail", "advice"}
        and all(isinstance(value[name], str) for name in ("code", "detail"))
        and isinstance(value["advice"], str | None)
    )


def _is_signature(value: Any) -> bool:
    return (
        isinstance(value, Mapping)
        and set(value) == {"manifest", "algorithm", "public_key", "signature"}
        and isinstance(value["manifest"], Mapping)
        and isinstance(value["manifest"].get("forms"), Mapping)
        and all(isinstance(value[name], str) for name in ("algorithm", "public_key", "signature"))
    )


_HEXADECIMAL = frozenset("0123456789abcdef")


def _is_sha256(value: Any) -> bool:
    return isinstance(value, str) and len(value) == 64 and _HEXADECIMAL.issuperset(value)


_BY_NAME: dict[str, Callable[[Any], bool]] = {
    "id": lambda value: isinstance(value, str) and is_id(value),
    "sha256": _is_sha256,
    "lens": _are_numbers_of("focal_length_mm", "pixel_pitch_um"),
    "intrinsics": _are_numbers_of(
        "fx_px", "fy_px", "cx_px", "cy_px", optional=("k1", "k2", "p1", "p2", "k3")
    ),
    "conditions": _are_conditions,
    "camera_mount": lambda value: value in ("robot", "fixed"),
    "certificate": _is_certificate,
    "print_kind": lambda value: value in ("paper", "plate", "glass"),
    "shape_standard_uncertainty": _are_numbers_of(
        "aspect", "shear", "bow_mm", "twist_mm", "quadratic_mm", "point_mm"
    ),
    "joint_angles_deg": _are_numbers,
    "position_mm": _are_numbers,
    "rotation": _are_rows,
    "covariance": _are_rows,
    "joints": _are_joints,
    "joint_coupling": _are_rows,
    "calibration": lambda value: isinstance(value, Mapping),
    "capture_quality": lambda value: isinstance(value, Mapping),
    "excluded": _is_exclusion,
    "signatories": _are_signatories,
    "failure": _is_report_failure,
    "signature": _is_signature,
}
_BY_TYPE: tuple[tuple[type[Any], Callable[[Any], bool]], ...] = (
    (sa.Text, lambda value: isinstance(value, str)),
    (sa.String, lambda value: isinstance(value, str)),
    (sa.Boolean, lambda value: isinstance(value, bool)),
    (sa.Integer, _is_whole),
    (sa.Double, _is_number),
)
