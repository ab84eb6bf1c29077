"""The fields that a report's build knew: what a later version states in addition is no disagreement."""

from __future__ import annotations

from typing import Any

_ANYTHING = None
"""The form of a null: nothing is known of what else may stand there."""


def known_fields(document: Any, earlier: Any) -> Any:
    """Return today's JSON document without the fields that no part of the earlier one in the same place has.

    Elements of lists stay, all of them: one that came or went is a disagreement.
    """
    return _pruned(document, _form(earlier))


def _form(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _form(item) for name, item in value.items()}
    if isinstance(value, list):
        merged: Any = _ANYTHING
        for item in value:
            merged = _merged(merged, _form(item))
        return [merged]
    return _ANYTHING


def _merged(one: Any, other: Any) -> Any:
    if isinstance(one, dict) and isinstance(other, dict):
        return {name: _merged(one.get(name), other.get(name)) for name in {**one, **other}}
    if isinstance(one, list) and isinstance(other, list):
        return [_merged(one[0], other[0])]
    return other if one is _ANYTHING else one


def _pruned(value: Any, form: Any) -> Any:
    if isinstance(value, dict) and isinstance(form, dict):
        return {name: _pruned(item, form[name]) for name, item in value.items() if name in form}
    if isinstance(value, list) and isinstance(form, list):
        return [_pruned(item, form[0]) for item in value]
    return value
