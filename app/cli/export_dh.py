"""`gridpose export dh`: a session's identified robot as a file."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import stamina
from rich.console import Console
from rich.markup import escape

from app.agent import ClientError, Json, ServiceClient
from app.cli.kinematic_models import WRITERS, Model
from app.cli.upload import find_session


class OptionRefused(Exception):
    """An option that cannot be meant so."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """The options of `gridpose export dh`."""

    session: str
    kind: str
    output: Path | None
    url: str
    key: str | None
    method: str
    source: str
    estimator: str
    joint_tolerance_deg: float | None
    sweeps: tuple[str, ...]
    names: str | None
    limits: str | None
    camera: bool
    retry_for_s: float


def export_dh(request: Request) -> int:
    """Ask the service, write the file, and return the exit code."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    stamina.instrumentation.set_on_retry_hooks([])
    try:
        model = _model(request, console)
    except OptionRefused as refused:
        console.print(f"[red]{escape(str(refused))}[/]")
        return 2
    except ClientError as error:
        console.print(f"[red]{escape(str(error))}[/]")
        if error.advice:
            console.print(escape(error.advice))
        return 1
    text = WRITERS[request.kind](model)
    if request.output is None:
        sys.stdout.write(text)
    else:
        try:
            request.output.write_text(text, encoding="utf-8", newline="\n")
        except OSError as error:
            console.print(f"[red]{escape(str(request.output))} cannot be written: {error.strerror}.[/]")
            return 1
        console.print(f"{escape(str(request.output))}: {len(model.joints)} joints")
    for warning in model.document["warnings"]:
        console.print(f"[yellow]{escape(warning['detail'])}[/]")
    return 0


def _model(request: Request, console: Console) -> Model:
    with ServiceClient(
        request.url,
        request.key,
        retry_for_s=request.retry_for_s,
        on_retry=lambda reason: console.print(f"[yellow]trying again: {escape(reason)}[/]"),
    ) as client:
        session_id = find_session(client, request.session)["id"]
        document = client.get(
            f"/v1/sessions/{session_id}/dh",
            method=request.method,
            source=request.source,
            estimator=request.estimator,
            joint_tolerance_deg=request.joint_tolerance_deg,
            sweep=list(request.sweeps) or None,
        )
        session = client.get(f"/v1/sessions/{session_id}")
        robot = {"name": session["name"], "joints": [{} for _ in document["joints"]]}
        if session["robot_id"] is not None:
            robot = client.get(f"/v1/robots/{session['robot_id']}")
    joints: list[Json] = robot["joints"]
    return Model(
        document,
        robot["name"],
        _names(request.names, [joint.get("name") for joint in joints]),
        _limits(request.limits, [(joint.get("lower_deg"), joint.get("upper_deg")) for joint in joints]),
        request.camera,
    )


def _names(text: str | None, stored: Sequence[str | None]) -> tuple[str, ...]:
    """Return the names that were given, else the robot's own; a joint without one is called by its number."""
    count = len(stored)
    if text is None:
        return tuple(
            name if name is not None else _unlike(f"joint_{i}", stored) for i, name in enumerate(stored, 1)
        )
    given = tuple(part.strip() for part in text.split(","))
    if len(given) != count or len(set(given)) != count or not all(given):
        raise OptionRefused(f"--joint-names needs {count} different names, separated by commas.")
    return given


def _unlike(name: str, others: Sequence[str | None]) -> str:
    while name in others:
        name += "_"
    return name


def _limits(
    text: str | None, stored: Sequence[tuple[float | None, float | None]]
) -> tuple[tuple[float, float] | None, ...]:
    """Return the limits that were given, else the robot's own."""
    if text is None:
        return tuple(None if low is None or high is None else (low, high) for low, high in stored)
    limits = []
    for part in text.split(","):
        low, colon, high = part.partition(":")
        try:
            pair = (float(low), float(high)) if colon else (-abs(float(low)), abs(float(low)))
        except ValueError:
            raise OptionRefused(f"--joint-limits has no degrees in {part!r}.") from None
        if not pair[0] < pair[1] or not all(abs(value) < 1e6 for value in pair):
            raise OptionRefused(f"--joint-limits has no range in {part!r}.")
        limits.append(pair)
    if len(limits) != len(stored):
        raise OptionRefused(f"--joint-limits needs {len(stored)} ranges, such as -155:155,-180:65,170.")
    return tuple(limits)
