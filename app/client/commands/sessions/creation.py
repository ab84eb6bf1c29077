"""`gridpose sessions create`."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from ... import Json, ServiceClient, find_robot
from ...resources import find_or_make_targets
from ..access import UploadAccess
from ..console import OptionRefused
from ..creation import AcceptImplausible, BodyFile, Name, create_named
from .mounts import CameraMount


def create(
    service: UploadAccess,
    name: Name = None,
    target: Annotated[
        list[str] | None,
        typer.Option(
            help="What the camera looks at: a target's id or name, sheet: and the id on its print, or its form, e.g. "
            "chessboard:9x6:25, which is made where the service has no such target. Repeat it for several."
        ),
    ] = None,
    robot: Annotated[str | None, typer.Option(help="Id or name of the robot.")] = None,
    camera_mount: Annotated[
        CameraMount | None, typer.Option(help="Whether the camera is on the robot, or fixed before it.")
    ] = None,
    focal_length_mm: Annotated[
        float | None, typer.Option(help="Focal length of the lens; needs --pixel-pitch-um, too.")
    ] = None,
    pixel_pitch_um: Annotated[
        float | None, typer.Option(help="Distance of neighbouring pixels on the sensor.")
    ] = None,
    file: BodyFile = None,
    accept_implausible: AcceptImplausible = False,
) -> None:
    """Begin a session: one camera looking at one or more targets.

    For example: gridpose sessions create "Cell 7" --target chessboard:9x6:25

    Prints the session's id as the last line.
    """

    def fields(client: ServiceClient) -> Json:
        given: dict[str, Any] = {}
        if target:
            given["target_ids"] = find_or_make_targets(client, target)
        if robot is not None:
            given["robot_id"] = find_robot(client, robot)["id"]
        if camera_mount is not None:
            given["camera_mount"] = camera_mount.value
        if (focal_length_mm is None) != (pixel_pitch_um is None):
            raise OptionRefused(
                "A lens is described by --focal-length-mm and --pixel-pitch-um.", "Give both."
            )
        if focal_length_mm is not None:
            given["lens"] = {"focal_length_mm": focal_length_mm, "pixel_pitch_um": pixel_pitch_um}
        return given

    with service.connect(file) as client:
        create_named(
            client,
            "session",
            name,
            file,
            fields,
            {"target_ids": "--target"},
            "gridpose upload FOLDER --session {id}",
            accept_implausible=accept_implausible,
        )
