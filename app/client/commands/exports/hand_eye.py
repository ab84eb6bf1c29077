"""`gridpose hand-eye export`: where the camera sits on the flange and the target in the base, as a file; or a fixed
camera in the base and the target on the flange.
"""

from __future__ import annotations

import enum
import json
from collections.abc import Callable
from typing import Annotated, Any

import typer
import yaml

from ... import Json, find_session
from ..access import ReadAccess
from ..console import OptionRefused
from ..output_files import Output, write_text
from ..rotations import to_quaternion

_MM = 1e-3
"""ROS has metres."""


class HandEyeFormat(enum.StrEnum):
    """Formats of a hand-eye calibration."""

    yaml = "yaml"
    json = "json"
    ros = "ros"


def export(
    session: Annotated[str, typer.Option(help="Id or name of the session.")],
    service: ReadAccess,
    file_format: Annotated[
        HandEyeFormat,
        typer.Option("--format", help="ros: commands of tf2_ros static_transform_publisher, in metres."),
    ] = HandEyeFormat.yaml,
    estimator: Annotated[str, typer.Option(help="As of the analysis.")] = "pooled",
    flange_frame: Annotated[str, typer.Option(help="Frame of the flange in ROS.")] = "tool0",
    camera_frame: Annotated[str, typer.Option(help="Frame of the camera in ROS.")] = "camera_optical_frame",
    base_frame: Annotated[str, typer.Option(help="Frame of the robot's base in ROS.")] = "base_link",
    target_frame: Annotated[
        str, typer.Option(help="Frame of the target in ROS; several get numbers.")
    ] = "target",
    output: Output = None,
) -> None:
    """Write a session's hand-eye calibration as YAML, JSON or ROS static transforms, with its uncertainty.

    Lengths are mm in YAML and JSON, metres in ROS; quaternions are x, y, z, w.
    """
    with service.connect() as client:
        frames = (flange_frame, camera_frame, base_frame, target_frame)
        if bad := [frame for frame in frames if not frame or any(c.isspace() or c in "'\"" for c in frame)]:
            raise OptionRefused(
                f"{bad[0]!r} is no name of a frame.", "Give a name without spaces and quotes."
            )
        session_id = find_session(client, session)["id"]
        found = client.get(f"/v1/sessions/{session_id}/hand-eye", estimator=estimator)
        if file_format is HandEyeFormat.ros:
            text = _ros(found, *frames)
        else:
            write: Callable[[Json], str] = _WRITERS[file_format]
            text = write(_content(found))
        write_text(text, output)


def _content(found: Json) -> Json:
    """Return what an export has of an analysis, with quaternions next to the matrices."""
    content: dict[str, Any] = {
        "session_id": found["session_id"],
        "inputs_sha256": found["inputs_sha256"],
        "core_version": found["core_version"],
        "lengths": "mm",
        "camera_mount": found["subject"]["camera_mount"],
        **_camera_and_targets(found),
        "warnings": [warning["detail"] for warning in found["warnings"]],
    }
    return content


def _camera_and_targets(found: Json) -> Json:
    """Return the camera and the targets under the names of their transforms."""
    camera_name, target_name, camera, targets = _frames(found)
    return {
        camera_name: _transform(camera, camera[camera_name]),
        target_name: [
            {"target_id": target["target_id"], **_transform(target, target[target_name])}
            for target in targets
        ],
    }


def _frames(found: Json) -> tuple[str, str, Json, list[Json]]:
    """Return the names of the camera's and the targets' transforms, and these: of a fixed camera that in the base."""
    if found["base_camera"] is not None:
        return "T_base_camera", "T_flange_target", found["base_camera"], found["flange_targets"]
    return "T_flange_camera", "T_base_target", found["flange_camera"], found["base_targets"]


def _transform(part: Json, matrix: list[list[float]]) -> Json:
    return {
        "matrix": matrix,
        "translation_mm": [row[3] for row in matrix[:3]],
        "quaternion_xyzw": [round(v, 9) for v in to_quaternion([row[:3] for row in matrix[:3]])],
        "standard_uncertainty": part["standard_uncertainty"],
        "covariance": part["covariance"],
    }


def _ros(found: Json, flange: str, camera: str, base: str, target: str) -> str:
    """Return commands that publish the transforms, and what is uncertain about them as comments."""
    lines = [f"# hand-eye calibration of session {found['session_id']}, inputs {found['inputs_sha256']}"]
    lines += [f"# {' '.join(str(warning['detail']).split())}" for warning in found["warnings"]]
    camera_name, target_name, of_camera, targets = _frames(found)
    is_fixed = camera_name == "T_base_camera"
    lines.append(_command(of_camera, camera_name, base if is_fixed else flange, camera))
    for number, one in enumerate(targets, 1):
        lines.append(f"# target {one['target_id']}")
        child = f"{target}_{number}" if len(targets) > 1 else target
        lines.append(_command(one, target_name, flange if is_fixed else base, child))
    return "\n".join(lines) + "\n"


def _command(part: Json, name: str, parent: str, child: str) -> str:
    matrix = part[name]
    x, y, z = (_MM * row[3] for row in matrix[:3])
    qx, qy, qz, qw = to_quaternion([row[:3] for row in matrix[:3]])
    values = {"x": x, "y": y, "z": z, "qx": qx, "qy": qy, "qz": qz, "qw": qw}
    options = " ".join(f"--{option} {value:.9f}" for option, value in values.items())
    return (
        f"ros2 run tf2_ros static_transform_publisher {options} --frame-id {parent} --child-frame-id {child}"
    )


def _yaml(content: Json) -> str:
    return yaml.safe_dump(content, sort_keys=False, default_flow_style=None, allow_unicode=True)


def _json(content: Json) -> str:
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


_WRITERS = {HandEyeFormat.yaml: _yaml, HandEyeFormat.json: _json}
