"""`gridpose robots export`: a session's identified robot as a file."""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from app.analyses.documents.robot_files import (
    WRITERS,
    Model,
    NoTerms,
    names_of,
    ranges_of,
    write_angle_table,
    write_terms_csv,
    write_terms_json,
)
from app.cli.options.access import ReadAccess
from app.client import Json, ServiceClient, find_session
from app.client.commands import OptionRefused, error_console, print_bytes, print_error


class ModelFormat(enum.StrEnum):
    """Formats a robot is written in."""

    urdf = "urdf"
    roboticstoolbox = "roboticstoolbox"
    yaml = "yaml"
    csv = "csv"
    terms_json = "terms-json"
    terms_csv = "terms-csv"
    angle_table = "angle-table"


_CHAIN_ALONE = (ModelFormat.urdf, ModelFormat.roboticstoolbox, ModelFormat.csv)
_ANY_COUPLING = (ModelFormat.yaml, ModelFormat.urdf, ModelFormat.terms_json)
_WRITERS: dict[ModelFormat, Callable[[Model], str]] = {
    **{ModelFormat(name): writer for name, writer in WRITERS.items()},
    ModelFormat.terms_json: write_terms_json,
    ModelFormat.terms_csv: write_terms_csv,
    ModelFormat.angle_table: write_angle_table,
}


_UNCONFIRMED = (
    "Curves of one session may be of that session alone. Correct commands by them only where a second session confirms "
    "them: gridpose robots compensate --help."
)


class DhMethod(enum.StrEnum):
    """Methods of identification."""

    cpa = "cpa"
    screw = "screw"
    combined = "combined"
    global_ = "global"


class DhModel(enum.StrEnum):
    """Terms beyond the chain."""

    auto = "auto"
    dh = "dh"
    extended = "extended"


class DhSource(enum.StrEnum):
    """Sources of a session's poses."""

    images = "images"
    measured_poses = "measured_poses"


def export_dh(
    session: Annotated[str, typer.Option(help="Id or name of the session.")],
    model_format: Annotated[
        ModelFormat,
        typer.Option(
            "--format",
            help="roboticstoolbox: Python for Peter Corke's Robotics Toolbox. csv: one row per joint. terms-json, "
            "terms-csv: joint curves and compliance. angle-table: CSV of the joint angle to command for each that is "
            "wanted.",
        ),
    ],
    service: ReadAccess,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File.  [default: stdout]")] = None,
    method: Annotated[DhMethod, typer.Option(help="As of the analysis.")] = DhMethod.global_,
    model: Annotated[
        DhModel | None,
        typer.Option(
            help="As of the analysis: terms beyond the chain, which yaml, terms and angle-table hold.  [default: auto "
            "for these; dh, the best chain by itself, for the others]"
        ),
    ] = None,
    source: Annotated[
        DhSource, typer.Option(help="Poses from images, or of another instrument.")
    ] = DhSource.images,
    estimator: Annotated[str, typer.Option(help="As of the analysis.")] = "pooled",
    joint_tolerance_deg: Annotated[
        float | None, typer.Option(help="How far resting joints may differ within a sweep.")
    ] = None,
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            help="JOINT:POSE,POSE,... lists the poses of a sweep, with * and ? as patterns; once per sweep."
        ),
    ] = None,
    joint_names: Annotated[
        str | None,
        typer.Option(
            help="Names of the joints, separated by commas.  [default: the robot's own, or joint_1, ...]"
        ),
    ] = None,
    joint_limits: Annotated[
        str | None,
        typer.Option(
            help="LOW:HIGH in degrees for each joint, separated by commas.  [default: the robot's own; else continuous]"
        ),
    ] = None,
    camera: Annotated[
        bool,
        typer.Option(help="Include the camera (or probe) as a link of the URDF, where it was identified."),
    ] = True,
) -> int:
    """Write a session's identified robot as URDF, Robotics Toolbox model, YAML or CSV."""
    console = error_console()
    taken = model or (DhModel.dh if model_format in _CHAIN_ALONE else DhModel.auto)
    with service.connect() as client:
        session_id = find_session(client, session)["id"]
        document = client.get(
            f"/v1/sessions/{session_id}/dh",
            method=method.value,
            model=taken.value,
            source=source.value,
            estimator=estimator,
            joint_tolerance_deg=joint_tolerance_deg,
            sweep=sweep or None,
        )
        robot = _robot(client, session_id, len(document["joints"]))
        if document["joint_coupling"] is not None and model_format not in _ANY_COUPLING:
            raise OptionRefused(
                "The robot's joints are coupled, which this format cannot express: its joints turn each by itself.",
                "Use --format yaml or terms-json, which have joint_coupling, or urdf, whose joints mimic; or drive "
                "the model with joint_coupling times the stated angles.",
            )
        joints: list[Json] = robot["joints"]
        written = Model(
            document,
            robot["name"],
            _names(joint_names, [joint.get("name") for joint in joints]),
            _limits(joint_limits, [(joint.get("minimum_deg"), joint.get("maximum_deg")) for joint in joints]),
            camera,
        )
    try:
        text = _WRITERS[model_format](written)
    except NoTerms as reason:
        print_error(console, str(reason), "--model extended takes all terms, whatever the evidence.")
        return 1
    if output is None:
        print_bytes(text.encode())
    else:
        try:
            output.write_text(text, encoding="utf-8", newline="\n")
        except OSError as error:
            print_error(console, f"{output} cannot be written: {error.strerror}.")
            return 1
        console.print(f"{escape(str(output))}: {len(written.joints)} joints")
    for line in statements(document):
        console.print(escape(line), soft_wrap=True)
    if model_format is ModelFormat.angle_table:
        console.print(f"[yellow]{_UNCONFIRMED}[/]", soft_wrap=True)
    for warning in document["warnings"]:
        console.print(f"[yellow]{escape(warning['detail'])}[/]")
    return 0


def statements(document: Json) -> list[str]:
    """Return one line each: which level was taken and why, what it gains, and where it holds."""
    if document["level"] is None:
        return []
    ranges = [
        f"joint {one['joint']} {one['minimum_deg']:.0f}° to {one['maximum_deg']:.0f}°"
        + (f" (without gaps over 10°: {len(one['gaps'])})" if one["gaps"] else "")
        for one in document["region"]["joints"]
    ]
    return [document["level"]["reason"], document["level"]["gain"], f"Holds within: {', '.join(ranges)}."]


def _robot(client: ServiceClient, session_id: str, joints: int) -> Json:
    """Return the session's robot, or one without names and limits."""
    session = client.get(f"/v1/sessions/{session_id}")
    if session["robot_id"] is None:
        return {"name": session["name"], "joints": [{} for _ in range(joints)]}
    return client.get(f"/v1/robots/{session['robot_id']}")


def _names(text: str | None, stored: Sequence[str | None]) -> tuple[str, ...]:
    """Return the given names, else the robot's own; a joint without a name gets its number."""
    count = len(stored)
    if text is None:
        return names_of(stored)
    given = tuple(part.strip() for part in text.split(","))
    if len(given) != count or len(set(given)) != count or not all(given):
        raise OptionRefused(f"--joint-names needs {count} different names, separated by commas.")
    return given


def _limits(
    text: str | None, stored: Sequence[tuple[float | None, float | None]]
) -> tuple[tuple[float, float] | None, ...]:
    """Return the given limits (low, high) in degrees, else the robot's own; None for continuous joints."""
    if text is None:
        return ranges_of(stored)
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
