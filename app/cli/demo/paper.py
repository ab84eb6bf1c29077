"""`gridpose demo --paper`: the paper's experiment through the real service, and its answers with the truth."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from app.cli.demo.arm_session import demo_arm_session, run_arm_session
from app.cli.demo.arm_tables import print_arm_introduction, report_arm
from app.cli.demo.command import (
    command_name,
    keep,
    make_console,
    new_folder,
    refuse_folder,
    report_failed_checks,
    report_failure,
)
from app.cli.demo.evaluation import (
    error_over_uncertainty,
    failed_checks,
    figures_with_truth,
    image_error,
)
from app.cli.demo.service_process import ServiceProcess, ServiceStartError
from app.cli.demo.session import (
    BOARD,
    DemoSession,
    PaperAnswers,
    demo_session,
    describe_robot,
    image_files,
    render_images,
    run_session,
)
from app.cli.demo.tables import (
    calibration_table,
    failures_of,
    image_table,
    methods_table,
    orientation_table,
    position_table,
    refusal_table,
)
from app.client import ClientError, ServiceClient, describe_measured
from app.client.commands import transfer_progress

PRINTED_ELSEWHERE = (
    "The paper's own Table II is an image in the copy at hand, so its figures are not repeated here."
)


def reproduce(data_dir: Path | None, seed: int, quick: bool = False) -> int:
    """Run the experiment; return 0 where every answer agrees with the truth."""
    console, folder = make_console(), new_folder(data_dir)
    if folder is None:
        return refuse_folder(console, data_dir)
    session = demo_session(seed, quick=quick)
    width, height = session.size_px
    console.print(
        f"[bold]A KUKA KR5 Arc, simulated, with a camera on its flange[/], visits five poses of a 100 mm cube "
        f"{session.cycles} times each before a {BOARD.columns} × {BOARD.rows} ChArUco board; one view more is all but "
        f"flat. {len(session.images)} images of {width} × {height} pixels, rendered with known truth.\n"
    )
    started = time.monotonic()
    arm_session = demo_arm_session(session.arm, seed, quick=quick)
    print_arm_introduction(console, arm_session)
    images, sweeps = folder / "images", folder / "sweeps"
    files = {**image_files(session.images, images), **image_files(arm_session.images, sweeps)}
    try:
        with transfer_progress(console) as progress, ServiceProcess(folder) as service:
            render_images(files, progress)
            with ServiceClient(service.url, service.admin_key) as client:
                robot_id = describe_robot(client)
                answers = run_session(client, session, robot_id, folder, progress)
                arm_answers = run_arm_session(client, arm_session, robot_id, sweeps, progress)
    except (ServiceStartError, ClientError) as error:
        return report_failure(console, error, folder)
    sound = _show(console, session, answers, folder)
    sound &= report_arm(console, arm_session, arm_answers, folder)
    console.print(f"\nIt took {time.monotonic() - started:.0f} s, rendering included.")
    _say_where(console, folder, service.admin_key or "", answers.session_id, arm_answers.session_id)
    return 0 if sound else 1


def _show(console: Console, session: DemoSession, answers: PaperAnswers, folder: Path) -> bool:
    """Print and keep the tables; return whether everything came out as it must."""
    truths = {(image.pose_id, image.cycle): image for image in session.images}
    accepted = [m for m in answers.measurements if m["status"] == "succeeded"]
    refused = [m for m in answers.measurements if m["status"] == "failed"]
    errors = [image_error(truths[m["pose_id"], m["cycle"]], m) for m in accepted]
    errors.sort(key=lambda error: error.pose_id)
    figures = figures_with_truth(session, answers.repeatability)
    keep(
        folder,
        {
            "measurements.json": answers.measurements,
            "repeatability.json": answers.repeatability,
            "comparison.json": answers.comparison,
            "truth.json": [asdict(figure) for figure in figures],
        },
    )
    focal_px = session.images[0].scene.camera.fx_px
    for table in (
        refusal_table(refused),
        image_table(errors),
        calibration_table(answers.comparison, focal_px),
        position_table(figures),
        orientation_table(figures),
        methods_table(answers.comparison, answers.fixed_centre, figures),
    ):
        console.print()
        console.print(table)
    console.print(PRINTED_ELSEWHERE, style="dim")
    for said in failures_of(answers.comparison):
        console.print(f"  {escape(said)}", style="dim")
    console.print()
    inside = sum(f.low <= f.true <= f.high for f in figures)
    found = failed_checks(session, answers, errors, figures)
    console.print(
        f"[bold]{describe_measured(answers.measurements, answers.repeatability['groups'])}.[/] Over all those "
        "with a camera of their own the true error is "
        f"{error_over_uncertainty(errors):.2f} times the stated standard uncertainty (1 would be exact, less is "
        f"cautious). {inside} of {len(figures)} intervals of repeatability hold the truth (95 % should)."
    )
    return not report_failed_checks(console, found)


def _say_where(console: Console, folder: Path, key: str, session_id: str, arm_session_id: str) -> None:
    console.print(
        f"\nAll of it is kept in [bold]{escape(str(folder))}[/]:\n"
        "  images/, sweeps/    what was rendered and uploaded\n"
        "  overlay-P1.png ...  the points found in it, with their residuals\n"
        "  scatter.svg         each pose's cycles, their ellipsoid, and the instrument's\n"
        "  drift.svg           the poses over the cycles\n"
        "  residuals.svg       what the lens model leaves over, by place in the image\n"
        "  measurements.json   the answers as the service gave them, image by image,\n"
        "  repeatability.json  pose by pose,\n"
        "  comparison.json     and method by method\n"
        "  truth.json          every figure of repeatability with its truth\n"
        "  dh.json             DH parameters, as the service gave them by every method,\n"
        "  dh-truth.json       and each with its truth\n"
        "  gridpose.sqlite3    the service's database, originals next to it\n"
        "\nTo look at it again, start the service on that folder and ask it:",
        soft_wrap=True,
    )
    console.print(
        f"  {command_name()} serve --data-dir {folder}\n"
        f"  export GRIDPOSE_URL=http://127.0.0.1:8000 GRIDPOSE_KEY={key}\n"
        f'  curl -H "Authorization: Bearer $GRIDPOSE_KEY" $GRIDPOSE_URL/v1/sessions/{session_id}/repeatability\n'
        f"  {command_name()} robots export --session {arm_session_id} --format urdf\n"
        f"  and in a browser: http://127.0.0.1:8000/ui/sessions/{session_id}/repeatability",
        soft_wrap=True,
        markup=False,
    )
