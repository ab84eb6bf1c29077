"""What validation finds, field by field, in our own words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from decimal import Decimal
from typing import Any

from app.errors import InvalidContent

_TYPE_WORDS = {
    "missing": "is required",
    "extra_forbidden": "is not a field known here",
    "finite_number": "must be a finite number",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_parsing_size": "is too large",
    "int_from_float": "must be a whole number",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "string_type": "must be text",
    "string_unicode": "must be valid Unicode text",
    "list_type": "must be a list",
    "dict_type": "must be an object",
    "model_type": "must be an object",
    "model_attributes_type": "must be an object",
    "none_required": "must be null",
    "json_invalid": "is not valid JSON",
}

_POSE_ID = "may hold the letters A to Z and a to z, digits, “.”, “_” and “-”, and does not begin with “.”"
FORMS = {
    r"^[^\x00-\x1f\x7f-\x9f]*$": "must be one line, without line breaks, tabs and other control characters",
    r"^[A-Za-z0-9_-][A-Za-z0-9._-]*$": _POSE_ID,
    r"^[A-Za-z0-9_-][A-Za-z0-9._-]{0,127}$": _POSE_ID,
    r"^[0-9A-Fa-f]{64}$": "must be 64 hexadecimal digits",
    r"^[A-Za-z0-9_]+$": "may hold the letters A to Z and a to z, digits and “_”",
    r"^[0-9]{4}-[01][0-9]-[0-3][0-9]$": "must be a day as YYYY-MM-DD, such as 2026-03-14",
    r"^[a-z_.]+$": "may hold the letters a to z, “_” and “.”",
    r"^[1-9][0-9]?:[A-Za-z0-9._*?-]{1,128}(,[A-Za-z0-9._*?-]{1,128})*$": "must be a joint's number, “:” and the pose "
    "ids of its sweep, separated by commas, such as 1:j1-*",
}
"""What a text must be like, by the pattern of its schema."""


def invalid_request(errors: Iterable[Any]) -> InvalidContent:
    """Return the refusal that pydantic's findings amount to, in our own words."""
    found = [(_field(error["loc"]), _message(error)) for error in errors]
    return InvalidContent(
        "The request's content is not valid.",
        "Correct the fields listed in errors.",
        errors=found[:100],
    )


def _number(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _field(location: Iterable[Any]) -> str:
    parts = [str(part) for part in location]
    if parts and parts[0] in ("body", "query", "path", "header"):
        parts = parts[1:]
    field = ".".join(parts) or "body"
    return field[:200].encode("utf-8", "replace").decode()


def _message(error: Mapping[str, Any]) -> str:
    kind, context = error["type"], error.get("ctx") or {}
    if kind in _TYPE_WORDS:
        return _TYPE_WORDS[kind]
    if kind == "string_too_short":
        return f"must have at least {_number(context['min_length'], 'character')}"
    if kind == "string_too_long":
        return f"must have at most {context['max_length']} characters"
    if kind == "too_short":
        return f"must have at least {_number(context['min_length'], 'item')}"
    if kind == "too_long":
        return f"must have at most {context['max_length']} items"
    for name, words in (
        ("gt", "greater than"),
        ("ge", "at least"),
        ("lt", "less than"),
        ("le", "at most"),
    ):
        if name in context:
            bound = context[name]
            return f"must be {words} {_plain(bound)}"
    if kind == "literal_error":
        return f"must be one of {context['expected']}"
    if kind == "string_pattern_mismatch":
        return FORMS.get(context["pattern"], "has characters or a form not allowed here")
    if kind == "value_error" and isinstance(context.get("error"), ValueError):
        return str(context["error"])
    return "is not valid"


def _plain(bound: float) -> str:
    """Return a bound without an exponent: 0.000001 and not 1e-06."""
    return str(bound) if isinstance(bound, int) else f"{Decimal(format(bound, 'g')):f}"
