"""`gridpose robots create`."""

from __future__ import annotations

import math
from typing import Annotated, Any

import typer

from app.cli.client_options import UploadAccess
from app.cli.console import OptionRefused
from app.cli.creation import AcceptImplausible, BodyFile, Name, create_named
from app.client import Json, ServiceClient

_PARAMETERS = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg", "minimum_deg", "maximum_deg")
_FORMS = (3, 4, 6)


def create(
    service: UploadAccess,
    name: Name = None,
    joint: Annotated[
        list[str] | None,
        typer.Option(
            help="A joint's classic (distal) Denavit-Hartenberg parameters, A_MM:ALPHA_DEG:D_MM, then "
            ":THETA_OFFSET_DEG and :MINIMUM_DEG:MAXIMUM_DEG if known; once per joint, the first at the base."
        ),
    ] = None,
    datasheet_repeatability_mm: Annotated[
        float | None, typer.Option(help="Position repeatability that the maker states.", min=0.0)
    ] = None,
    file: BodyFile = None,
    accept_implausible: AcceptImplausible = False,
) -> int:
    """Make a robot with its nominal Denavit-Hartenberg parameters.

    For example, two joints: gridpose robots create arm --joint 180:-90:400 --joint 600:0:0:-90:-170:170

    Prints the robot's id as the last line.
    """

    def fields(_: ServiceClient) -> Json:
        given: dict[str, Any] = {}
        if joint:
            given["joints"] = [_joint(text) for text in joint]
        if datasheet_repeatability_mm is not None:
            given["datasheet_repeatability_mm"] = datasheet_repeatability_mm
        return given

    return service.run(
        lambda client: create_named(
            client,
            "robot",
            name,
            file,
            fields,
            {"joints": "--joint"},
            "gridpose sessions create NAME --robot {id}",
            accept_implausible=accept_implausible,
        )
    )


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
