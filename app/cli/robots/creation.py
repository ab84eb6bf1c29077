"""`gridpose robots create` and `change`."""

from __future__ import annotations

import math
import re
from typing import Annotated

import typer

from app.cli.client_options import UploadAccess
from app.cli.console import OptionRefused
from app.cli.creation import AcceptImplausible, BodyFile, Name, create_named
from app.client import Json, ServiceClient, find_robot

_PARAMETERS = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg", "minimum_deg", "maximum_deg")
_FORMS = (3, 4, 6)
_PAIR = re.compile(r"(\d{1,2}):(\d{1,2}):([-+]?(?:\d+\.?\d*|\.\d+))")


_Joints = Annotated[
    list[str] | None,
    typer.Option(
        "--joint",
        help="A joint's classic (distal) Denavit-Hartenberg parameters, A_MM:ALPHA_DEG:D_MM, then "
        ":THETA_OFFSET_DEG and :MINIMUM_DEG:MAXIMUM_DEG if known; once per joint, the first at the base.",
    ),
]
_Coupling = Annotated[
    list[str] | None,
    typer.Option(
        "--joint-coupling",
        help="A joint whose angle follows another's, JOINT:OTHER:SHARE, e.g. 3:2:1 where joint 3 of the model turns by "
        "its stated angle and that of joint 2; once per pair, with all joints.",
    ),
]
_Manufacturer = Annotated[str | None, typer.Option(help="Who made the robot.")]
_Model = Annotated[str | None, typer.Option(help="What its maker calls it.")]
_SerialNumber = Annotated[str | None, typer.Option(help="The number on its plate.")]
_Repeatability = Annotated[
    float | None, typer.Option(help="Position repeatability that the maker states.", min=0.0)
]
_Accuracy = Annotated[float | None, typer.Option(help="Position accuracy that the maker states.", min=0.0)]


def create(
    service: UploadAccess,
    name: Name = None,
    joint: _Joints = None,
    joint_coupling: _Coupling = None,
    manufacturer: _Manufacturer = None,
    model: _Model = None,
    serial_number: _SerialNumber = None,
    datasheet_repeatability_mm: _Repeatability = None,
    datasheet_accuracy_mm: _Accuracy = None,
    file: BodyFile = None,
    accept_implausible: AcceptImplausible = False,
) -> int:
    """Make a robot with its nominal Denavit-Hartenberg parameters.

    For example, two joints: gridpose robots create arm --joint 180:-90:400 --joint 600:0:0:-90:-170:170

    Prints the robot's id as the last line.
    """
    texts = {"manufacturer": manufacturer, "model": model, "serial_number": serial_number}
    promised = {
        "datasheet_repeatability_mm": datasheet_repeatability_mm,
        "datasheet_accuracy_mm": datasheet_accuracy_mm,
    }
    return service.run(
        lambda client: create_named(
            client,
            "robot",
            name,
            file,
            lambda _: _given(joint, joint_coupling, texts, promised),
            {"joints": "--joint"},
            "gridpose sessions create NAME --robot {id}",
            accept_implausible=accept_implausible,
        )
    )


def change(
    robot: Annotated[str, typer.Argument(help="Id or name of the robot.")],
    service: UploadAccess,
    name: Annotated[str | None, typer.Option(help="The robot's new name.")] = None,
    joint: _Joints = None,
    joint_coupling: _Coupling = None,
    manufacturer: _Manufacturer = None,
    model: _Model = None,
    serial_number: _SerialNumber = None,
    datasheet_repeatability_mm: _Repeatability = None,
    datasheet_accuracy_mm: _Accuracy = None,
) -> int:
    """Change what is stated of a robot; joints are given whole.

    Analyses of its sessions use the change.
    """
    texts = {"name": name, "manufacturer": manufacturer, "model": model, "serial_number": serial_number}
    promised = {
        "datasheet_repeatability_mm": datasheet_repeatability_mm,
        "datasheet_accuracy_mm": datasheet_accuracy_mm,
    }

    def act(client: ServiceClient) -> None:
        changes = _given(joint, joint_coupling, texts, promised)
        if not changes:
            raise OptionRefused(
                "Nothing is to be changed.", "Give what is new, e.g. --datasheet-accuracy-mm .5."
            )
        robot_id = find_robot(client, robot)["id"]
        client.change(f"/v1/robots/{robot_id}", changes)
        print(f"{robot_id} changed")

    return service.run(act)


def _given(joint: list[str] | None, coupling: list[str] | None, texts: Json, promised: Json) -> Json:
    """Return the fields of a robot that the options name."""
    fields = {name: value for name, value in {**texts, **promised}.items() if value is not None}
    if coupling and not joint:
        raise OptionRefused("--joint-coupling needs the joints.", "Give every --joint, too.")
    if joint:
        fields["joints"] = [_joint(text) for text in joint]
    if coupling:
        fields["joint_coupling"] = _matrix(coupling, len(fields["joints"]))
    return fields


def _matrix(coupling: list[str], joints: int) -> list[list[float]]:
    """Return the coupling of joints: ones on the diagonal, and the shares that are given."""
    matrix = [[float(row == column) for column in range(joints)] for row in range(joints)]
    for text in coupling:
        match = _PAIR.fullmatch(text)
        row, column = (int(match[1]), int(match[2])) if match else (0, 0)
        if match is None or row == column or not (1 <= row <= joints and 1 <= column <= joints):
            raise OptionRefused(
                f"--joint-coupling {text} does not name two of the {joints} joints and a share.",
                "Write JOINT:OTHER:SHARE, joints counted from 1, e.g. 3:2:1.",
            )
        matrix[row - 1][column - 1] = float(match[3])
    return matrix


def _joint(text: str) -> dict[str, float]:
    try:
        values = [float(part) for part in text.split(":")]
    except ValueError:
        values = []
    if len(values) not in _FORMS or not all(map(math.isfinite, values)):
        raise OptionRefused(
            f"--joint {text} does not describe a joint.",
            "Write A_MM:ALPHA_DEG:D_MM, e.g. 180:-90:400; then :THETA_OFFSET_DEG, and :MINIMUM_DEG:MAXIMUM_DEG.",
        )
    return dict(zip(_PARAMETERS, values, strict=False))
