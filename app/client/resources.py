"""Sessions, targets and robots by id or name; sessions and targets are created where they do not exist."""

from __future__ import annotations

import re

from .http import ClientError, Json, ServiceClient

_TARGET = re.compile(r"(?P<kind>[a-z_]+):(?P<columns>[0-9]+)x(?P<rows>[0-9]+):(?P<pitch>[0-9]+(\.[0-9]+)?)")


def find_session(client: ServiceClient, session: str) -> Json:
    """Return the session with this id or name.

    Raises
    ------
    ClientError
        `session_not_found`, or `session_ambiguous` where several sessions have this name.
    """
    found = _find_session(client, session)
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
        An id, or a description `KIND:COLUMNSxROWS:PITCH_MM`, e.g. `chessboard:9x6:25`. A described target is created
        where the service has none like it.
    accept_implausible
        Whether a target is created whose lengths look like another unit (`implausible_unit`).

    Raises
    ------
    ClientError
        `session_not_found` (a new name without a target), `session_ambiguous`, or `target_not_in_session`.
    """
    found = _find_session(client, session)
    if found is not None:
        return found["id"], _target_of(client, found, target)
    if target is None:
        raise ClientError(
            "session_not_found",
            f"No session has the id or the name {session!r}.",
            "To create it, give its target, e.g. --target chessboard:9x6:25 (inner corners, mm).",
        )
    target_id = find_or_make_target(client, target, accept_implausible=accept_implausible)
    created = client.create("/v1/sessions", {"name": session, "target_ids": [target_id]})
    return created["id"], target_id


def _find_session(client: ServiceClient, session: str) -> Json | None:
    matches = _matching(client, "/v1/sessions", session)
    if len(matches) > 1:
        ids = ", ".join(entry["id"] for entry in matches)
        raise ClientError(
            "session_ambiguous", f"Several sessions have the name {session!r}: {ids}.", "Give the id."
        )
    return matches[0] if matches else None


def _matching(client: ServiceClient, path: str, name: str) -> list[Json]:
    """Return the one entry of a list with this id, else all with this name."""
    matches = []
    for entry in client.items(path):
        if entry["id"] == name:
            return [entry]
        if entry["name"] == name:
            matches.append(entry)
    return matches


def _target_of(client: ServiceClient, session: Json, target: str | None) -> str | None:
    """Return the id of the session's target that is given by id or description; None where none is given."""
    if target is None:
        return None
    if target in session["target_ids"]:
        return target
    fields = _described_target(target)
    if fields is not None:
        for target_id in session["target_ids"]:
            if _matches(client.get(f"/v1/targets/{target_id}"), fields):
                return str(target_id)
    raise ClientError(
        "target_not_in_session",
        f"The target {target} does not belong to the session.",
        "Omit --target to use the session's own targets, or correct them with `gridpose sessions change`, which "
        "searches its images again.",
    )


def find_or_make_target(client: ServiceClient, target: str, *, accept_implausible: bool = False) -> str:
    """Return the id of a target given by id or description; a described one is made where it does not exist."""
    fields = _described_target(target)
    if fields is None:
        return target
    for entry in client.items("/v1/targets"):
        if _matches(entry, fields):
            return str(entry["id"])
    path = "/v1/targets?accept_implausible=true" if accept_implausible else "/v1/targets"
    return str(client.create(path, {"name": target, **fields})["id"])


def _described_target(text: str) -> Json | None:
    """Return the target that `KIND:COLUMNSxROWS:PITCH_MM` describes, or None for any other text."""
    match = _TARGET.fullmatch(text)
    if match is None:
        return None
    return {
        "kind": match["kind"],
        "columns": int(match["columns"]),
        "rows": int(match["rows"]),
        "pitch_mm": float(match["pitch"]),
    }


def _matches(target: Json, fields: Json) -> bool:
    return all(target[name] == value for name, value in fields.items())
