"""`gridpose robots create` and `change`."""

from __future__ import annotations

import dataclasses
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from ... import Json, find_robot
from ...http import insisting_query
from ..access import UploadAccess
from ..console import OptionRefused, error_console
from ..creation import AcceptImplausible, BodyFile, Name, create_named
from .joint_files import programs_hint, read_joints
from .known import known_robot

_PARAMETERS = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg", "minimum_deg", "maximum_deg")
_FORMS = (3, 4, 6)
_PAIR = re.compile(r"(\d{1,2}):(\d{1,2}):([-+]?(?:\d+\.?\d*|\.\d+))")


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotOptions:
    """What is stated of a robot."""

    joint: Annotated[
        list[str] | None,
        typer.Option(
            help="A joint's classic (distal) Denavit-Hartenberg parameters, A_MM:ALPHA_DEG:D_MM, then "
            ":THETA_OFFSET_DEG and :MINIMUM_DEG:MAXIMUM_DEG if known; once per joint, the first at the base.",
        ),
    ] = None
    joints_from: Annotated[
        Path | None,
        typer.Option(
            help="File with the joints instead: a URDF, or a CSV with a_mm, alpha_deg, d_mm, theta_offset_deg, "
            "beta_deg, minimum_deg, maximum_deg; also one of `gridpose robots export`.",
            exists=True,
            dir_okay=False,
        ),
    ] = None
    known: Annotated[
        str | None,
        typer.Option(
            help="Model whose maker's parameters are known, e.g. UR5e; see `gridpose robots list --known`."
        ),
    ] = None
    joint_coupling: Annotated[
        list[str] | None,
        typer.Option(
            help="A joint whose angle follows another's, JOINT:OTHER:SHARE, e.g. 3:2:1 where joint 3 of the model "
            "turns by its stated angle and that of joint 2, or 3:3:-1 where it counts the other way; once per pair, "
            "with all joints.",
        ),
    ] = None
    manufacturer: Annotated[str | None, typer.Option(help="Who made the robot.")] = None
    model: Annotated[str | None, typer.Option(help="What its maker calls it.")] = None
    serial_number: Annotated[str | None, typer.Option(help="The number on its plate.")] = None
    datasheet_repeatability_mm: Annotated[
        float | None, typer.Option(help="Position repeatability that the maker states.", min=0.0)
    ] = None
    datasheet_accuracy_mm: Annotated[
        float | None, typer.Option(help="Position accuracy that the maker states.", min=0.0)
    ] = None

    def stated(self) -> Json:
        """Return the fields of a robot that the options name; raises OptionRefused."""
        values = {name: value for name, value in dataclasses.asdict(self).items() if value is not None}
        joint, coupling = values.pop("joint", None), values.pop("joint_coupling", None)
        file, known = values.pop("joints_from", None), values.pop("known", None)
        if sum(given is not None for given in (joint or None, file, known)) > 1:
            raise OptionRefused(
                "The joints are given twice.", "Give one of --joint, --joints-from and --known."
            )
        if joint:
            values["joints"] = [_joint(text) for text in joint]
        elif file is not None:
            values["joints"] = read_joints(file, lambda line: error_console().print(escape(line)))
        elif known is not None:
            values = _known(known) | values
        if coupling and "joints" not in values:
            raise OptionRefused("--joint-coupling needs the joints.", "Give every --joint, too.")
        if coupling:
            values["joint_coupling"] = _matrix(coupling, len(values["joints"]))
        return values


def create(
    service: UploadAccess,
    robot: RobotOptions,
    name: Name = None,
    file: BodyFile = None,
    accept_implausible: AcceptImplausible = False,
) -> None:
    """Make a robot with its nominal Denavit-Hartenberg parameters: by joint, from a CSV or URDF, or by its model.

    For example, two joints: gridpose robots create arm --joint 180:-90:400 --joint 600:0:0:-90:-170:170; from a URDF:
    gridpose robots create arm --joints-from arm.urdf; by its model: gridpose robots create "Cell 7" --known UR5e

    Prints the robot's id as the last line.
    """
    with service.connect(file) as client:
        create_named(
            client,
            "robot",
            name,
            file,
            lambda _: robot.stated(),
            {"joints": "--joint, --joints-from or --known"},
            "gridpose sessions create NAME --robot {id}",
            accept_implausible=accept_implausible,
        )


def change(
    robot: Annotated[str, typer.Argument(help="Id or name of the robot.")],
    service: UploadAccess,
    changed: RobotOptions,
    name: Annotated[str | None, typer.Option(help="The robot's new name.")] = None,
    accept_implausible: AcceptImplausible = False,
) -> None:
    """Change what is stated of a robot; joints are given whole.

    Analyses of its sessions use the change.
    """
    with service.connect() as client:
        changes = changed.stated() | ({} if name is None else {"name": name})
        if not changes:
            raise OptionRefused(
                "Nothing is to be changed.", "Give what is new, e.g. --datasheet-accuracy-mm .5."
            )
        robot_id = find_robot(client, robot)["id"]
        client.change(f"/v1/robots/{robot_id}{insisting_query(accept_implausible)}", changes)
        print(f"{robot_id} changed")


def _known(model: str) -> Json:
    robot = known_robot(model)
    if robot is None:
        raise OptionRefused(
            f"The parameters of {model!r} are not known here.",
            "`gridpose robots list --known` shows those that are; or give --joints-from with the maker's URDF.",
        )
    error_console().print(f"{escape(robot.maker)} {escape(robot.model)} by {escape(robot.source)}")
    if robot.base is not None:
        error_console().print(programs_hint("the flange in the controller's base", f"--base {robot.base}"))
    return robot.fields()


def _matrix(coupling: list[str], joints: int) -> list[list[float]]:
    """Return the coupling of joints: ones on the diagonal where nothing else is given, and the given shares."""
    matrix = [[float(row == column) for column in range(joints)] for row in range(joints)]
    for text in coupling:
        match = _PAIR.fullmatch(text)
        row, column = (int(match[1]), int(match[2])) if match else (0, 0)
        if match is None or not (1 <= row <= joints and 1 <= column <= joints):
            raise OptionRefused(
                f"--joint-coupling {text} does not name joints from 1 to {joints} and a share.",
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
