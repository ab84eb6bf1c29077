"""Sessions, targets and robots by id or name; sessions and targets are created where they do not exist."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

from ..http import ArgumentRefused, ClientError, Json, ServiceClient
from .sheets import sheet_matcher

_ID = re.compile(r"[a-z]{3}_[0-9a-z]{26}")
_NOT_FOUND = 404
_LONGEST_NAME = 200
_TARGET = re.compile(r"[a-z_]+:(?P<columns>[0-9]{1,4})x(?P<rows>[0-9]{1,4}):(?P<pitch>[0-9]+(\.[0-9]+)?)")
_EXAMPLES = {
    "chessboard": "chessboard:9x6:25",
    "charuco": "charuco:9x6:25,marker=18,dictionary=DICT_5X5_100",
    "circles": "circles:9x6:25",
    "asymmetric_circles": "asymmetric_circles:4x11:20",
    "aprilgrid": "aprilgrid:6x6:88,marker=80",
}
_KINDS = frozenset(_EXAMPLES)
_COUNTED = {"circles": "dots", "asymmetric_circles": "dots", "aprilgrid": "tags"}
_FORM_FIELDS = {
    "marker": "marker_mm",
    "marker_mm": "marker_mm",
    "dictionary": "dictionary",
    "legacy_layout": "legacy_layout",
    "print_kind": "print_kind",
    "u": "pitch_standard_uncertainty_mm",
    "pitch_standard_uncertainty_mm": "pitch_standard_uncertainty_mm",
}
_NAMED = 5
"""Ids that a message lists."""
_TRUTHS = {"true": True, "yes": True, "false": False, "no": False}


def find_session(client: ServiceClient, session: str) -> Json:
    """Return the session with this id or name.

    Raises
    ------
    ClientError
        `session_not_found`, or `session_ambiguous` where several sessions have this name.
    """
    found = existing_session(client, session)
    if found is None:
        raise ClientError(
            "session_not_found",
            f"No session has the id or the name {session!r}.",
            "Check the name, or give the id; `gridpose sessions list` shows them.",
        )
    return found


def find_robot(client: ServiceClient, robot: str) -> Json:
    """Return the robot with this id or name.

    Raises
    ------
    ClientError
        `robot_not_found`, or `robot_ambiguous` where several robots have this name.
    """
    matches = _matching(client, "/v1/robots", robot)
    if len(matches) != 1:
        raise ClientError(
            "robot_ambiguous" if matches else "robot_not_found",
            f"{'Several robots have' if matches else 'No robot has'} the id or the name {robot!r}.",
            "Give the id; `gridpose robots list` shows them.",
        )
    return matches[0]


def find_or_make_session(
    client: ServiceClient, session: str, target: str | None, *, accept_implausible: bool = False
) -> tuple[str, str | None]:
    """Return the session's id, and the target's id where `target` is given.

    Parameters
    ----------
    session
        An id, or the name of exactly one session. A new name creates a session, which needs a target.
    target
        As `find_or_make_target` takes it.
    accept_implausible
        Whether a target is created whose lengths look like another unit (`implausible_unit`).

    Raises
    ------
    ClientError
        `session_not_found` (a new name without a target), `session_ambiguous`, `target_not_in_session` (a session
        that is there), or for a new session as `find_or_make_target` does.
    """
    found = existing_session(client, session)
    if found is not None:
        return found["id"], target_of_session(client, found, target)
    if target is None:
        raise ClientError(
            "session_not_found",
            f"No session has the id or the name {session!r}.",
            "To create it, give its target, e.g. --target chessboard:9x6:25 (inner corners, mm).",
        )
    target_id = find_or_make_target(client, target, accept_implausible=accept_implausible)
    created = client.create("/v1/sessions", {"name": session, "target_ids": [target_id]})
    return created["id"], target_id


def existing_session(client: ServiceClient, session: str) -> Json | None:
    """Return the session with this id or name, or None. Raises ClientError `session_ambiguous`."""
    matches = _matching(client, "/v1/sessions", session)
    if len(matches) > 1:
        ids = ", ".join(entry["id"] for entry in matches[:_NAMED])
        more = f" and {len(matches) - _NAMED} more" if len(matches) > _NAMED else ""
        raise ClientError(
            "session_ambiguous",
            f"{len(matches)} sessions have the name {session!r}: {ids}{more}.",
            "Give the id; `gridpose sessions list` shows them.",
        )
    return matches[0] if matches else None


def _matching(client: ServiceClient, path: str, name: str) -> list[Json]:
    """Return the one entry of a list with this id, else all with this name."""
    if _ID.fullmatch(name):
        try:
            return [client.get(f"{path}/{name}")]
        except ClientError as error:
            if error.status != _NOT_FOUND:
                raise
    is_a_name = 0 < len(name) <= _LONGEST_NAME and name.isprintable()
    return list(client.items(path, name=name)) if is_a_name else []


def target_of_session(client: ServiceClient, session: Json, target: str | None) -> str | None:
    """Return the id of the session's target that is given by id, name, sheet or form; None where none is given."""
    if target is None:
        return None
    if target in session["target_ids"]:
        return target
    fields = described_target(target)
    is_meant = _is_meant(target, fields)
    found = [str(t) for t in session["target_ids"] if is_meant(client.get(f"/v1/targets/{t}"))]
    if len(found) == 1 or (found and fields is not None):
        return found[0]
    raise ClientError(
        "target_not_in_session",
        f"The target {target} does not belong to the session.",
        "Omit --target to use the session's own targets, or correct them with `gridpose sessions change`, which "
        "searches its images again.",
    )


def find_or_make_target(client: ServiceClient, target: str, *, accept_implausible: bool = False) -> str:
    """Return the id of a target given by id, name, sheet or form; one given by form is made where it is new.

    A sheet is `sheet:` and the id that is printed on it. The form is `KIND:COLUMNSxROWS:PITCH_MM`, then fields after
    commas, such as `,marker=18,dictionary=DICT_5X5_100`.

    Raises
    ------
    ClientError
        `target_not_described` for a form that cannot be read, `target_not_found`, or `target_ambiguous`.
    """
    fields = described_target(target)
    if fields is None:
        return str(find_target(client, target)["id"]) if not target.startswith("tgt_") else target
    is_meant = _is_meant(target, fields)
    for entry in client.items("/v1/targets"):
        if is_meant(entry):
            return str(entry["id"])
    path = "/v1/targets?accept_implausible=true" if accept_implausible else "/v1/targets"
    try:
        return str(client.create(path, {"name": target[:200], **fields})["id"])
    except ClientError as error:
        if error.code == "invalid_target":
            error.advice = f"{error.advice or ''} Write it as --target {_EXAMPLES[fields['kind']]}.".strip()
        raise


def find_or_make_targets(client: ServiceClient, targets: Sequence[str]) -> list[str]:
    """Return the ids of targets as `find_or_make_target` does; none is made where one cannot be read."""
    for target in targets:
        described_target(target)
        sheet_matcher(target)
    return [find_or_make_target(client, target) for target in targets]


def find_target(client: ServiceClient, target: str) -> Json:
    """Return the target with this id or name, or that is printed on this sheet; none is made.

    Raises ClientError `target_not_found` or `target_ambiguous`.
    """
    return (
        _named_target(client, target)
        if not target.startswith("tgt_")
        else client.get(f"/v1/targets/{target}")
    )


def check_target(client: ServiceClient, target: str) -> None:
    """Raise ClientError for a target that neither is there nor has a form it could be made by; make nothing."""
    if described_target(target) is None and not target.startswith("tgt_"):
        _named_target(client, target)


def described_target(text: str) -> Json | None:
    """Return the fields of the target that a form describes, or None for an id or a name.

    Raises ArgumentRefused `target_not_described` for a text that begins like a form and cannot be read as one.
    """
    kind = text.partition(":")[0]
    if kind not in _KINDS or ":" not in text:
        return None
    head, *rest = text.split(",")
    match = _TARGET.fullmatch(head)
    if match is None:
        raise _not_described(text, f"{head} is not {kind}:COLUMNSxROWS:PITCH_MM")
    fields: Json = {
        "kind": kind,
        "columns": int(match["columns"]),
        "rows": int(match["rows"]),
        "pitch_mm": float(match["pitch"]),
    }
    for part in rest:
        name, equals, value = part.strip().partition("=")
        field = _FORM_FIELDS.get(name)
        if field is None:
            raise _not_described(text, f"{name} is no field of a target")
        try:
            fields[field] = _CONVERTERS.get(field, float)(value if equals else "true")
        except ValueError:
            raise _not_described(text, f"{part} has no value that fits") from None
    return fields


def _truth(text: str) -> bool:
    if text not in _TRUTHS:
        raise ValueError(text)
    return _TRUTHS[text]


_CONVERTERS: dict[str, Callable[[str], Any]] = {
    "legacy_layout": _truth,
    "dictionary": str,
    "print_kind": str,
}


def _not_described(text: str, reason: str) -> ArgumentRefused:
    kind = text.partition(":")[0]
    return ArgumentRefused(
        "target_not_described",
        f"--target {text} cannot be read: {reason}.",
        f"Write it as {_EXAMPLES[kind]}; columns and rows count {_COUNTED.get(kind, 'inner corners')}, lengths are mm.",
    )


def _named_target(client: ServiceClient, target: str) -> Json:
    """Return the one target with this name, or that is printed on this sheet."""
    is_meant = _is_meant(target, None)
    matches = [entry for entry in client.items("/v1/targets") if is_meant(entry)]
    if len(matches) == 1:
        return matches[0]
    forms = f"--target chessboard:9x6:25 or --target {_EXAMPLES['charuco']}"
    if sheet_matcher(target) is not None:
        raise ClientError(
            "target_ambiguous" if matches else "target_not_found",
            f"{'Several targets' if matches else 'No target'} of the service would be printed as {target}.",
            "Give the id (`gridpose targets list` shows them)."
            if matches
            else f"Give the form of what the sheet states after its id, e.g. {forms}.",
        )
    raise ClientError(
        "target_ambiguous" if matches else "target_not_found",
        f"{'Several targets have' if matches else 'No target has'} the id or the name {target!r}.",
        f"Give the id (`gridpose targets list` shows them), or a form, e.g. {forms}, or the id on its print, "
        "e.g. --target sheet:gp-5d49aa3e.",
    )


def _is_meant(target: str, fields: Json | None) -> Callable[[Json], bool]:
    """Return what determines whether a target is the one given by its form's fields, else by sheet, id or name."""
    if fields is not None:
        return lambda entry: all(entry[name] == value for name, value in fields.items())
    return sheet_matcher(target) or (lambda entry: target in (entry["id"], entry["name"]))
