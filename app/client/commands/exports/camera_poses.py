"""`gridpose camera-poses export`: the camera's pose in every image, for hand-eye calibration elsewhere."""

from __future__ import annotations

import csv
import enum
import io
import json
from typing import Annotated, Any

import typer

from ... import Json, find_session
from ..access import ReadAccess
from ..output_files import Output, write_text
from ..rotations import to_quaternion

_AXES = ("x", "y", "z")


class TableFormat(enum.StrEnum):
    """Formats of a table."""

    csv = "csv"
    json = "json"


def export(
    session: Annotated[str, typer.Option(help="Id or name of the session.")],
    service: ReadAccess,
    file_format: Annotated[TableFormat, typer.Option("--format", help="json: as the service answers it.")] = (
        TableFormat.csv
    ),
    estimator: Annotated[str, typer.Option(help="As of the analysis.")] = "pooled",
    output: Output = None,
) -> None:
    """Write the camera's pose in every image of a session: mm and quaternion x, y, z, w, in the target's frame."""
    with service.connect() as client:
        session_id = find_session(client, session)["id"]
        found = client.get(f"/v1/sessions/{session_id}/camera-poses", estimator=estimator)
        if file_format is TableFormat.json:
            text = json.dumps(found, indent=2, allow_nan=False) + "\n"
        else:
            text = _csv(found["camera_poses"])
        write_text(text, output)


def _csv(images: list[Json]) -> str:
    rows = [_row(image) for image in images]
    written = io.StringIO(newline="")
    if rows:
        writer = csv.DictWriter(written, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return written.getvalue()


def _row(image: Json) -> dict[str, Any]:
    """Return an image's row; the cells of its pose are empty where it has none."""
    pose = image["pose"]
    position = pose["position_mm"] if pose is not None else [None] * 3
    quaternion = [round(v, 10) for v in to_quaternion(pose["rotation"])] if pose is not None else [None] * 4
    uncertainty = pose["standard_uncertainty"] if pose is not None else {}
    return {
        **{
            name: str(image[name]).lower() if isinstance(image[name], bool) else image[name]
            for name in ("measurement_id", "pose_id", "cycle", "target_id", "used", "rejection")
        },
        **{f"{axis}_mm": value for axis, value in zip(_AXES, position, strict=True)},
        **dict(zip(("qx", "qy", "qz", "qw"), quaternion, strict=True)),
        **{f"u_{axis}_mm": uncertainty.get(f"{axis}_mm") for axis in _AXES},
        "rms_px": image["rms_px"],
    }
