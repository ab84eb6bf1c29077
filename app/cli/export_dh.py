"""`gridpose export dh`: a session's identified robot as a file."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import stamina
from rich.console import Console
from rich.markup import escape

from app.agent import ClientError, ServiceClient
from app.cli.kinematic_models import WRITERS, Model
from app.cli.upload import find_or_make_session


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
        session_id, _ = find_or_make_session(client, request.session, None)
        document = client.get(
            f"/v1/sessions/{session_id}/dh",
            method=request.method,
            source=request.source,
            estimator=request.estimator,
            joint_tolerance_deg=request.joint_tolerance_deg,
            sweep=list(request.sweeps) or None,
        )
        session = client.get(f"/v1/sessions/{session_id}")
        name = session["name"]
        if session["robot_id"] is not None:
            name = client.get(f"/v1/robots/{session['robot_id']}")["name"]
    count = len(document["joints"])
    return Model(document, name, _names(request.names, count), _limits(request.limits, count), request.camera)


def _names(text: str | None, count: int) -> tuple[str, ...]:
    if text is None:
        return tuple(f"joint_{i}" for i in range(1, count + 1))
    names = tuple(part.strip() for part in text.split(","))
    if len(names) != count or len(set(names)) != count or not all(names):
        raise OptionRefused(f"--joint-names needs {count} different names, separated by commas.")
    return names


def _limits(text: str | None, count: int) -> tuple[tuple[float, float], ...] | None:
    if text is None:
        return None
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
    if len(limits) != count:
        raise OptionRefused(f"--joint-limits needs {count} ranges, such as -155:155,-180:65,170.")
    return tuple(limits)
