"""`gridpose demo`: a robot session through the real service, and its answers beside the truth."""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress

from app.agent import ClientError, Json, ServiceClient, plan_files
from app.cli.demo_tables import Comparison, compare, position_table, refusal_table, rotation_table
from app.cli.process import ServiceProcess, ServiceStartError
from app.cli.upload import transfer, transfer_progress
from core.errors import FocalNotObservable
from core.simulation import SessionImage, render, robot_session, standard_camera, standard_target
from core.transforms import invert, rotation_to_rpy, so3_exp, transform

POSES, CYCLES = 5, 3
SIZE_PX = (2448, 2050)
FLAT = "flat"
FLAT_TILT = math.radians(0.3)
# Where the stated uncertainties are honest, the errors over them have a root mean square of 1, within the
# spread of so few images.
HONEST_BELOW = 2.0


def demonstrate(data_dir: Path | None, seed: int) -> int:
    """Run the demo; return 0 where every image came out as it must."""
    console = Console(highlight=False)
    folder = data_dir or Path(tempfile.mkdtemp(prefix="gridpose-demo-"))
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        message = f"[red]{escape(str(folder))} is not empty;[/] give --data-dir a new folder."
        console.print(message, soft_wrap=True)
        return 2
    session = demo_session(seed)
    console.print(
        f"[bold]A camera on a robot's flange, {POSES} poses, {CYCLES} cycles[/], and one view that is "
        f"all but flat: {len(session)} images of {SIZE_PX[0]} × {SIZE_PX[1]} pixels, rendered with known truth.\n"
    )
    try:
        with transfer_progress(console) as progress, ServiceProcess(folder) as service:
            _render(session, folder / "images", progress)
            measurements, session_id = _run(service, session, folder, progress)
    except (ServiceStartError, ClientError) as error:
        console.print(f"[red]{escape(str(error))}[/]\nWhat was made is in {escape(str(folder))}.")
        return 1
    (folder / "measurements.json").write_text(json.dumps(measurements, indent=2) + "\n", encoding="utf-8")
    sound = _show(console, session, measurements)
    _say_where(console, folder, service.admin_key or "", session_id)
    return 0 if sound else 1


def demo_session(seed: int) -> list[SessionImage]:
    """Return the images to be taken: ordinary poses, and a nearly fronto-parallel view as one more."""
    target = standard_target(9, 6)
    camera = replace(standard_camera(), cx_px=1244.0, cy_px=1009.0)  # off-centre, as real lenses are
    images = robot_session(target, camera, SIZE_PX, poses=POSES, cycles=CYCLES, seed=seed)
    first = images[0]
    distance_mm = float(np.linalg.norm(first.commanded_T_target_camera[:3, 3]))
    middle = target.points_target().mean(axis=0)
    rotation = so3_exp(FLAT_TILT * np.array([1.0, 0.0, 0.0]))
    T_camera_target = transform(rotation, np.array([0.0, 0.0, distance_mm]) - rotation @ middle)
    scene = replace(first.scene, T_camera_target=T_camera_target, seed=seed)
    return [*images, SessionImage(FLAT, 1, invert(T_camera_target), scene)]


def _render(session: Sequence[SessionImage], folder: Path, progress: Progress) -> None:
    task = progress.add_task("rendering", total=len(session))
    for image in session:
        path = folder / image.pose_id / f"c{image.cycle}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        written, data = cv2.imencode(".png", render(image.scene))
        assert written
        path.write_bytes(data.tobytes())
        progress.advance(task)


def _run(
    service: ServiceProcess, session: Sequence[SessionImage], folder: Path, progress: Progress
) -> tuple[list[Json], str]:
    """Do what a shop-floor PC does: describe target, session and poses, upload, wait, read."""
    target = session[0].scene.target
    with ServiceClient(service.url, service.admin_key) as client:
        target_id = client.create(
            "/v1/targets",
            {
                "name": f"Chessboard {target.columns} × {target.rows}",
                "kind": target.kind,
                "columns": target.columns,
                "rows": target.rows,
                "pitch_mm": target.pitch_mm,
            },
        )["id"]
        session_id: str = client.create("/v1/sessions", {"name": "Demo", "target_ids": [target_id]})["id"]
        commanded = {image.pose_id: image.commanded_T_target_camera for image in session}
        for pose_id, T_target_camera in commanded.items():
            client.put(f"/v1/sessions/{session_id}/poses/{pose_id}", _pose_body(T_target_camera))
        plan = plan_files(folder / "images")
        outcomes, result = transfer(client, session_id, plan.images, progress, wait=True)
        assert result is not None
        failed = [outcome for outcome in outcomes if outcome.status == "failed"]
        if failed:
            raise ClientError("upload_failed", f"{failed[0].name}: {failed[0].reason}", failed[0].advice)
        for measurement in result.measurements:
            if measurement["status"] == "succeeded" and measurement["cycle"] == 1:
                picture = client.get_bytes(f"/v1/measurements/{measurement['id']}/overlay")
                (folder / f"overlay-{measurement['pose_id']}.png").write_bytes(picture)
    return list(result.measurements), session_id


def _pose_body(T_target_camera: Float[np.ndarray, "4 4"]) -> Json:
    roll, pitch, yaw = np.degrees(rotation_to_rpy(T_target_camera[:3, :3])).tolist()
    position_mm = T_target_camera[:3, 3].tolist()
    return {"position_mm": position_mm, "roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw}


def _show(console: Console, session: Sequence[SessionImage], measurements: Sequence[Json]) -> bool:
    """Print the tables and the verdict; return whether every image came out as it must."""
    truths = {(image.pose_id, image.cycle): image for image in session}
    by_tag: dict[tuple[str, int], Json] = {(m["pose_id"], m["cycle"]): m for m in measurements}
    accepted = [m for m in measurements if m["status"] == "succeeded"]
    refused = [m for m in measurements if m["status"] == "failed"]
    rows = [compare(truths[m["pose_id"], m["cycle"]], m) for m in accepted]
    rows.sort(key=lambda row: row.name)

    for table in (position_table(rows), rotation_table(rows), refusal_table(refused)):
        console.print()
        console.print(table)
    console.print()
    ratio = _overall(rows)
    flat: dict[str, Any] = by_tag.get((FLAT, 1), {}).get("failure") or {}
    faults = []
    if len(rows) != POSES * CYCLES or set(by_tag) != set(truths):
        faults.append(f"{len(rows)} of {POSES * CYCLES} tilted views were calibrated")
    if flat.get("code") != FocalNotObservable.code:
        faults.append("the flat view was not refused for its focal length")
    if not ratio < HONEST_BELOW:
        faults.append(f"errors are {ratio:.1f} times what was stated")
    console.print(
        f"[bold]{len(rows)} images calibrated, {len(refused)} refused.[/] Over all of them the true error is "
        f"{ratio:.2f} times the stated standard uncertainty (1 would be exact, less is cautious)."
    )
    for fault in faults:
        console.print(f"[red]This is not as it must be: {escape(fault)}.[/]")
    return not faults


def _overall(rows: Sequence[Comparison]) -> float:
    """Return the root mean square of all errors over their standard uncertainties."""
    if not rows:
        return math.nan
    return math.sqrt(float(np.mean([[r.position_ratio**2, r.rotation_ratio**2] for r in rows])))


def _say_where(console: Console, folder: Path, key: str, session_id: str) -> None:
    console.print(
        f"\nAll of it is kept in [bold]{escape(str(folder))}[/]:\n"
        "  images/             what was rendered and uploaded\n"
        "  overlay-P1.png ...  the points found in it, with their residuals\n"
        "  measurements.json   the answers as the service gave them\n"
        "  gridpose.sqlite3    the service's database, originals beside it\n"
        "\nTo look at it again, start the service on that folder and ask it:",
        soft_wrap=True,
    )
    console.print(
        f"  {_command()} serve --data-dir {folder}\n"
        f"  curl -H 'Authorization: Bearer {key}' \\\n"
        f"    http://127.0.0.1:8000/v1/sessions/{session_id}/measurements\n"
        "  and in a browser: http://127.0.0.1:8000/docs",
        soft_wrap=True,
        markup=False,
    )


def _command() -> str:
    """Return what to type for `gridpose` here, where its folder need not be on the PATH."""
    script = Path(sys.executable).with_name("gridpose")
    if not script.exists():
        return f"{sys.executable} -m app.cli"
    here = Path.cwd()
    return str(script.relative_to(here)) if script.is_relative_to(here) else str(script)
