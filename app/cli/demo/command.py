"""`gridpose demo`: a small rendered session through the real service, from images to a table of repeatability."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from app.cli.demo.evaluation import ImageError, failed_checks, figures_with_truth, image_error
from app.cli.demo.service_process import ServiceProcess, ServiceStartError
from app.cli.demo.session import (
    BOARD,
    Answers,
    DemoSession,
    describe_robot,
    describe_session,
    image_files,
    measure_image,
    render_images,
    small_session,
    upload_session,
)
from app.cli.demo.tables import POSE_LEGEND, pose_table
from app.client import ClientError, Json, ServiceClient, describe_measured
from app.client.commands import transfer_progress
from core.simulation import SessionImage

MAX_COLUMNS = 80


def run_demo(data_dir: Path | None, seed: int) -> int:
    """Run the small demo; return 0 where every answer agrees with the truth."""
    console, folder = make_console(), new_folder(data_dir)
    if folder is None:
        return refuse_folder(console, data_dir)
    session = small_session(seed)
    width, height = session.size_px
    console.print(
        f"[bold]A simulated robot visits {len(session.poses)} poses, {session.cycles} times each.[/] The camera on "
        f"its flange sees a {BOARD.columns} × {BOARD.rows} ChArUco board. Gridpose calibrates every image "
        f"({width} × {height} pixels) by itself and determines how well the robot comes back to each pose."
    )
    started = time.monotonic()
    try:
        with transfer_progress(console) as progress, ServiceProcess(folder) as service:
            console.print(f"The service runs at {service.url} until the demo ends.")
            with ServiceClient(service.url, service.admin_key) as client:
                session_id = describe_session(client, session, describe_robot(client))

                def show_first(path: Path) -> None:
                    _show_image(console, session, measure_image(client, session_id, path, folder))

                render_images(image_files(session.images, folder / "images"), progress, show_first)
                measurements = upload_session(client, session_id, folder, progress)
                repeatability = client.get(f"/v1/sessions/{session_id}/repeatability")
                plot = client.get_bytes(f"/v1/sessions/{session_id}/repeatability/scatter.svg")
    except (ServiceStartError, ClientError) as error:
        return report_failure(console, error, folder)
    (folder / "scatter.svg").write_bytes(plot)
    keep(folder, {"measurements.json": measurements, "repeatability.json": repeatability})
    is_sound = _show(console, session, Answers(session_id, measurements, repeatability))
    console.print(f"\nPlot of each pose's positions: {folder / 'scatter.svg'}", soft_wrap=True, markup=False)
    console.print(f"It took {time.monotonic() - started:.0f} s, most of it for rendering.")
    _say_what_next(console, folder, service.admin_key or "", session_id)
    return 0 if is_sound else 1


def _show_image(console: Console, session: DemoSession, measurement: Json) -> None:
    """Print one image's result next to its truth, while the others are rendered."""
    if measurement["status"] != "succeeded":
        return
    error = image_error(_image_of(session, measurement), measurement)
    console.print(describe_image(error, session.images[0].scene.camera.fx_px))


def describe_image(error: ImageError, true_focal_px: float) -> str:
    """Return the sentence for one image: focal length and position, next to their truth, each with its u."""
    return (
        f"First image (± one standard uncertainty): focal length {true_focal_px + error.focal_error_px:.1f} ± "
        f"{error.focal_uncertainty_px:.1f} px, true {true_focal_px:.1f}; the camera's position is "
        f"{error.position_error_mm:.2f} mm off the truth, its standard uncertainty "
        f"{error.position_uncertainty_mm:.2f} mm."
    )


def _image_of(session: DemoSession, measurement: Json) -> SessionImage:
    tag = (measurement["pose_id"], measurement["cycle"])
    return next(image for image in session.images if (image.pose_id, image.cycle) == tag)


def _show(console: Console, session: DemoSession, answers: Answers) -> bool:
    """Print the table of poses and the refused image; return whether all of it agrees with the truth."""
    accepted = [m for m in answers.measurements if m["status"] == "succeeded"]
    rejected = [m for m in answers.measurements if m["status"] == "failed"]
    figures = figures_with_truth(session, answers.repeatability)
    images = {row["pose_id"]: row["cycles"] for row in answers.repeatability["poses"]}
    console.print()
    console.print(pose_table(figures, images))
    console.print(POSE_LEGEND, style="dim")
    cameras = answers.repeatability["groups"]
    console.print(f"\n[bold]{describe_measured(answers.measurements, cameras)}.[/]")
    for m in rejected:
        failure = m["failure"]
        console.print(f"  {m['pose_id']}: {escape(failure['detail'])} ({failure['code']})")
        console.print(f"  What to do: {escape(failure['advice'] or '')}")
    errors = [image_error(_image_of(session, m), m) for m in accepted]
    return not report_failed_checks(console, failed_checks(session, answers, errors, figures))


def _say_what_next(console: Console, folder: Path, key: str, session_id: str) -> None:
    """Print where the data are, the command that opens them, and what to try."""
    gridpose = command_name()
    console.print(
        f"\nKept are images, answers and the service's database in\n  {folder}\n"
        f"Open them:  {gridpose} serve --data-dir {folder}\n"
        "Then, in a browser, sign in on this page with this key:\n"
        f"  http://127.0.0.1:8000/ui/sessions/{session_id}/repeatability\n"
        f"  {key}\n"
        "Or on the command line:\n"
        "  export GRIDPOSE_URL=http://127.0.0.1:8000\n"
        f"  export GRIDPOSE_KEY={key}\n"
        f'  curl -H "Authorization: Bearer $GRIDPOSE_KEY" \\\n'
        f"    $GRIDPOSE_URL/v1/sessions/{session_id}/repeatability\n"
        "Try next:\n"
        f"  {gridpose} targets print --help   print a board of your own\n"
        f"  {gridpose} upload --help          send a folder of images\n"
        f"  {gridpose} demo --paper           the paper's tables, in four minutes",
        soft_wrap=True,
        markup=False,
    )


def make_console() -> Console:
    """Return a console of at most 80 columns."""
    console = Console(highlight=False, emoji=False)
    console.width = min(console.width, MAX_COLUMNS)
    return console


def new_folder(data_dir: Path | None) -> Path | None:
    """Return the empty folder to keep the session in, a temporary one where none is given; None if it is not empty."""
    folder = data_dir or Path(tempfile.mkdtemp(prefix="gridpose-demo-"))
    folder.mkdir(parents=True, exist_ok=True)
    return None if any(folder.iterdir()) else folder


def refuse_folder(console: Console, folder: Path | None) -> int:
    """Say that the folder is not empty; return the exit code."""
    console.print(
        f"[red]{escape(str(folder))} is not empty;[/] give --data-dir a new folder.", soft_wrap=True
    )
    return 2


def report_failure(console: Console, error: Exception, folder: Path) -> int:
    """Say why the demo ended early; return the exit code."""
    console.print(f"[red]{escape(str(error))}[/]\nWhat was made is in {escape(str(folder))}.", soft_wrap=True)
    return 1


def report_failed_checks(console: Console, found: list[str]) -> list[str]:
    """Print what disagrees with the truth, and return it."""
    for failed_check in found:
        console.print(f"[red]This is not as it must be: {escape(failed_check)}.[/]")
    return found


def keep(folder: Path, documents: Mapping[str, Json | list[Json]]) -> None:
    """Write documents as JSON files."""
    for name, document in documents.items():
        (folder / name).write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")


def command_name() -> str:
    """Return what to type for `gridpose` here, where its folder need not be on the PATH."""
    script = Path(sys.executable).with_name("gridpose")
    if not script.exists():
        return f"{sys.executable} -m app.cli"
    here = Path.cwd()
    return str(script.relative_to(here)) if script.is_relative_to(here) else str(script)
