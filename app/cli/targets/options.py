"""Options that describe a target, or give one stored in a service."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from typing import Annotated

import typer

from app.cli.options.access import ReadAccess
from app.client import ClientError, Json
from app.client.commands import TargetDescription, error_console
from core import TargetSpec
from core.errors import InvalidArgument
from core.targets import check_fields, target_of

_ID = re.compile(r"[0-9A-Za-z_-]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetOptions(TargetDescription):
    """The options that describe a target, or give one stored in a service; None where not given."""

    target_id: Annotated[
        str | None, typer.Option(help="Id of a target stored in a service, instead of its description.")
    ] = None


@dataclass(frozen=True, slots=True)
class TargetChoice:
    """A target, and its name in a service."""

    target: TargetSpec
    name: str | None


def choose_target(options: TargetOptions, service: ReadAccess) -> TargetChoice:
    """Return the target that is described by options, or stored in a service.

    Raises
    ------
    InvalidArgument
        The options give no target, or two.
    InvalidTarget
        The described target is impossible.
    ClientError
        The service does not return the target.
    """
    described = options.given
    if options.target_id is not None:
        if described:
            raise InvalidArgument(
                f"--target-id excludes {', '.join(described)}.", "Give the id or the description."
            )
        if _ID.fullmatch(options.target_id) is None:
            raise InvalidArgument(
                f"--target-id {options.target_id!r} is not an id.",
                "Ids begin with tgt_; `gridpose targets list` shows them.",
            )
        with service.client(error_console()) as client:
            return stored_target(client.get(f"/v1/targets/{options.target_id}"))
    missing = [name for name in ("--kind", "--columns", "--rows", "--pitch-mm") if name not in described]
    if missing:
        raise InvalidArgument(
            f"The target is not described: {', '.join(missing)} missing.",
            "Describe the target, e.g. --kind chessboard --columns 9 --rows 6 --pitch-mm 25, or give the "
            "--target-id of one in a service.",
        )
    target = TargetSpec(
        str(options.kind),
        options.columns or 0,
        options.rows or 0,
        options.pitch_mm or 0.0,
        options.marker_mm,
        options.dictionary,
        options.legacy_layout,
    )
    check_fields(target)
    return TargetChoice(target, None)


def stored_target(answer: Json) -> TargetChoice:
    """Return a target from the service's answer.

    Raises ClientError for fields that this version does not know.
    """
    known = {field.name for field in fields(TargetSpec)}
    unknown = set(answer) - known - {"id", "name", "created_at"}
    if unknown:
        raise ClientError(
            "unknown_fields",
            f"The service's target has fields that this program does not know: {', '.join(sorted(unknown))}.",
            "Update gridpose on this machine.",
        )
    return TargetChoice(target_of({name: answer[name] for name in known & set(answer)}), answer["name"])
