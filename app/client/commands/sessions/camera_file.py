"""`gridpose sessions export-camera`: a session's camera as a file of another program."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from ... import find_session
from ..access import ReadAccess
from ..console import error_console, print_error
from ..output_files import print_bytes

_STATED = ("# largest_conversion_error", "# standard_uncertainty", "# warning")
"""How the lines of a file begin that a user has to know."""


class CameraFormat(enum.StrEnum):
    """Formats a camera is written in."""

    opencv = "opencv"
    ros = "ros"
    kalibr = "kalibr"
    mrcal = "mrcal"


def export_camera(
    session: Annotated[str, typer.Argument(help="Id or name of the session.")],
    camera_format: Annotated[
        CameraFormat,
        typer.Option(
            "--format",
            help="opencv: YAML of cv::FileStorage. ros: YAML of CameraInfo. kalibr: camchain. mrcal: .cameramodel.",
        ),
    ],
    service: ReadAccess,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File.  [default: stdout]")] = None,
    estimator: Annotated[str, typer.Option(help="As of the analysis.")] = "pooled",
    lens_model: Annotated[
        str | None, typer.Option(help="As of the analysis.  [default: as the images ask for]")
    ] = None,
    focus_group: Annotated[
        str | None, typer.Option(help="The camera setting, where the session has several.")
    ] = None,
) -> int:
    """Write a session's camera for OpenCV, ROS, Kalibr or mrcal, with the largest error of the conversion."""
    console = error_console()
    with service.connect() as client:
        session_id = find_session(client, session)["id"]
        data = client.get_bytes(
            f"/v1/sessions/{session_id}/intrinsics/export",
            format=camera_format.value,
            estimator=estimator,
            lens_model=lens_model,
            focus_group=focus_group,
        )
    if output is None:
        print_bytes(data)
        return 0
    try:
        output.write_bytes(data)
    except OSError as error:
        print_error(console, f"{output} cannot be written: {error.strerror}.")
        return 1
    console.print(f"{escape(str(output))}:")
    for line in data.decode().splitlines():
        if line.startswith(_STATED):
            console.print(f"  {escape(line[2:])}")
    return 0
