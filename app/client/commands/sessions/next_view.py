"""`gridpose sessions next-view`: where to take the next images of a target."""

from __future__ import annotations

import enum
import math
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from ... import Json, find_session
from ...resources import target_of_session
from ..access import UploadAccess
from ..console import output_console, print_json
from ..record_files import FileRefused, read_records
from .poses import fields_of_poses

_SHOWN = (("projection_rms_px", "px"), ("length_rms_mm", "mm"), ("angle_rms_deg", "°"))
_DIGITS = 2


class Purpose(enum.StrEnum):
    """What further views are to determine."""

    INTRINSICS = "intrinsics"
    HAND_EYE = "hand_eye"
    DH = "dh"


def next_view(
    session: Annotated[str, typer.Argument(help="Id or name of the session.")],
    service: UploadAccess,
    purpose: Annotated[
        Purpose,
        typer.Option(
            "--for", help="What is to become certain: the camera, its mount on the flange, or the robot."
        ),
    ] = Purpose.INTRINSICS,
    target: Annotated[
        str | None,
        typer.Option(help="The target to look at, by id or name; the session's first unless stated."),
    ] = None,
    count: Annotated[int, typer.Option(min=1, max=50, help="Views to suggest.")] = 3,
    candidates: Annotated[
        Path | None,
        typer.Option(
            help="File of the poses to choose from: CSV with j1_deg, j2_deg, ... as `poses load` reads it, JSON or "
            "YAML.  [default: any view within reach]",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the service's answer unchanged.")] = False,
) -> None:
    """Suggest the views that would make a session's camera, hand-eye calibration or robot most certain."""
    with service.connect() as client:
        found = find_session(client, session)
        asked: Json = {"purpose": purpose.value, "count": count}
        if target is not None:
            asked["target_id"] = target_of_session(client, found, target)
        if candidates is not None:
            asked["candidates"] = poses_to_choose_from(candidates)
        answer = client.create(f"/v1/sessions/{found['id']}/next-view", asked)
        if as_json:
            print_json(answer)
        else:
            print_views(answer)


def poses_to_choose_from(file: Path) -> list[Json]:
    """Return the joint angles that the rows of a file state; raises FileRefused where one states none."""
    records = read_records(file, None, None)
    found = []
    for record, fields in fields_of_poses(records):
        angles = fields.get("joint_angles_deg")
        if not angles:
            raise FileRefused(
                f"In {record.place} there are no joint angles.", "Fill j1_deg, j2_deg, ... of every row."
            )
        found.append({"joint_angles_deg": angles})
    if not found:
        raise FileRefused("The file holds no poses.", "Write one pose per line, with j1_deg, j2_deg, ...")
    return found


def print_views(found: Json) -> None:
    """Print each view as a camera's user sees it, and what it makes of the uncertainty, each after those before it."""
    console = output_console()
    for warning in found["warnings"]:
        console.print(f"note: {escape(warning['detail'])}")
    for number, view in enumerate(found["suggestions"], 1):
        now, after = view["expected_uncertainty_now"], view["expected_uncertainty_after"]
        gains = [
            f"{_rounded(now[name])} -> {_rounded(after[name])} {unit}"
            for name, unit in _SHOWN
            if now[name] is not None
        ]
        earlier = next(n for n, other in enumerate(found["suggestions"], 1) if _place(other) == _place(view))
        again = f"view {earlier} once more: " if earlier < number else ""
        console.print(f"{number}. {again}{view['instruction']}: {', '.join(gains)}")
        if view["joint_angles_deg"] is not None:
            console.print(f"   joints {', '.join(f'{angle:.2f}' for angle in view['joint_angles_deg'])} °")


def _place(view: Json) -> tuple[Any, Any]:
    """Return where a view is taken from: what views that are one and the same share."""
    return view["T_target_camera"], view["joint_angles_deg"]


def _rounded(value: float) -> str:
    """Return an uncertainty with two significant digits."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    shown = float(f"{value:.{_DIGITS - 1}e}")
    return f"{shown:.{max(0, _DIGITS - 1 - math.floor(math.log10(abs(shown))))}f}"
