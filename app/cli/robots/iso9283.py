"""`gridpose robots plan iso9283`: the standard's test poses as files, and a forecast of the session."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.analyses.documents.iso9283 import PLAN_WRITERS, PlanRefused, TestRequest, plan_test, sentences
from app.cli.options.access import ReadAccess
from app.cli.targets.options import TargetOptions, choose_target
from app.client import ClientError, Json
from app.client.commands import OptionRefused, error_console, output_console, print_error
from core import GridposeError, Lens
from core.metrology import CYCLES, TEST_PLANES
from core.simulation import MAX_IMAGES_PER_STOP


def plan_iso9283(
    target: TargetOptions,
    service: ReadAccess,
    side_mm: Annotated[float, typer.Option(help="Edge of the test cube.")],
    focal_length_mm: Annotated[float, typer.Option(help="Of the lens.")],
    pixel_pitch_um: Annotated[float, typer.Option(help="Of the sensor.")],
    image: Annotated[str, typer.Option(help="Size of an image in pixels, WIDTHxHEIGHT.")] = "2448x2050",
    centre_mm: Annotated[str, typer.Option(help="Centre of the cube in the base frame, X,Y,Z.")] = "0,0,0",
    orientation_deg: Annotated[
        str, typer.Option(help="Of the flange at all poses, ROLL,PITCH,YAW in the base frame.")
    ] = "180,0,0",
    plane: Annotated[
        str, typer.Option(help=f"Test plane of the cube, by its corners: {', '.join(TEST_PLANES)}.")
    ] = next(iter(TEST_PLANES)),
    distance_mm: Annotated[float, typer.Option(help="From the camera at P1 to the target.")] = 700.0,
    tilt_deg: Annotated[float, typer.Option(help="Of the target against the image plane.")] = 20.0,
    cycles: Annotated[int, typer.Option(help="Visits to each pose.", min=2, max=200)] = CYCLES,
    images_per_stop: Annotated[
        int,
        typer.Option(
            help="Images at each stop, a burst: their scatter is the instrument's noise without a model.",
            min=1,
            max=MAX_IMAGES_PER_STOP,
        ),
    ] = 1,
    corner_sigma_px: Annotated[
        float, typer.Option(help="Noise of a grid point; .02 px in a sharp image, .05 in a poor one.")
    ] = 0.02,
    rp_mm: Annotated[float, typer.Option(help="RP_l that the robot is expected to have.")] = 0.05,
    limit_mm: Annotated[float | None, typer.Option(help="RP_l of the data sheet, to be decided on.")] = None,
    load_kg: Annotated[
        list[float] | None, typer.Option(help="Load of a run; the rated one is the standard's. Repeatable.")
    ] = None,
    speed_percent: Annotated[
        list[float] | None,
        typer.Option(help="Speed of a run; the standard has 100, 50 and 10. Repeatable."),
    ] = None,
    approaches: Annotated[
        int, typer.Option(help="Directions from which P1, P2 and P4 are approached.", min=1, max=6)
    ] = 1,
    approach_mm: Annotated[float, typer.Option(help="Length of the last straight way to a pose.")] = 50.0,
    warm_up_min: Annotated[
        float | None, typer.Option(help="How long the robot moves before the first cycle.", min=0.0)
    ] = None,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output", "-o", help="File: .json the plan, .csv the poses, .pdf a check list. Repeatable."
        ),
    ] = None,
) -> int:
    """Write the standard's test poses, and predict floor, intervals and verdicts of the session.

    The camera is taken to look along the flange's z axis, its x axis along the flange's. Four views tilted by 25° are
    planned in addition to the five poses: they determine the lens and the print.
    """
    try:
        for path in output or ():
            if path.suffix not in PLAN_WRITERS:
                raise OptionRefused(
                    f"{path.name} ends in no format that is written.", "Use .json, .csv or .pdf."
                )
        asked = TestRequest(
            centre_mm=_three("--centre-mm", centre_mm),
            side_mm=side_mm,
            focal_px=Lens(focal_length_mm, pixel_pitch_um).focal_px,
            size_px=_size(image),
            orientation_deg=_three("--orientation-deg", orientation_deg),
            plane=plane,
            distance_mm=distance_mm,
            tilt_deg=tilt_deg,
            cycles=cycles,
            images_per_stop=images_per_stop,
            corner_sigma_px=corner_sigma_px,
            rp_mm=rp_mm,
            limit_mm=limit_mm,
            loads_kg=tuple(load_kg or ()),
            speeds_percent=tuple(speed_percent or ()),
            approaches=approaches,
            approach_mm=approach_mm,
            warm_up_min=warm_up_min,
        )
        plan = plan_test(choose_target(target, service).target, asked)
        for path in output or ():
            path.write_bytes(PLAN_WRITERS[path.suffix](plan))
    except OptionRefused as refused:
        print_error(error_console(), str(refused), refused.advice)
        return 2
    except PlanRefused as refused:
        print_error(error_console(), refused.detail, refused.advice)
        return 2
    except (GridposeError, ClientError) as error:
        print_error(error_console(), error.detail, error.advice)
        return 1
    except OSError as error:
        print_error(error_console(), f"The plan cannot be written: {error}.")
        return 1
    _show(plan)
    return 0


def _three(name: str, text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise OptionRefused(f"{name} {text} is not three numbers.", "Write X,Y,Z, e.g. 900,0,450.") from None
    if not all(map(math.isfinite, (x, y, z))):
        raise OptionRefused(f"{name} {text} is not three numbers.", "Write X,Y,Z, e.g. 900,0,450.")
    return x, y, z


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and min(int(width), int(height)) >= 16):
        raise OptionRefused(f"--image {text} is no size.", "Write WIDTHxHEIGHT, e.g. 2448x2050.")
    return int(width), int(height)


def _show(plan: Json) -> None:
    console = output_console()
    table = Table(title=f"Predicted for RP_l {plan['assumed']['rp_l_mm']:g} mm, {plan['cycles']} cycles")
    for column in ("pose", "noise floor mm", "RP_l read mm", "95 % interval mm", "verdicts"):
        table.add_column(column)
    for one in plan["forecast"]:
        if not one["in_view"]:
            table.add_row(one["pose_id"], "-", "-", "-", "the target is not wholly in the image")
            continue
        low, high = one["interval_mm"]
        verdicts = ", ".join(f"{name} {share:.0%}" for name, share in one["verdicts"].items())
        row = (f"{one['noise_floor_mm']:.3g}", f"{one['rp_l_mm']:.3g}", f"{low:.3g} to {high:.3g}", verdicts)
        table.add_row(one["pose_id"], *row)
    console.print(table)
    for sentence in sentences(plan):
        console.print(sentence)
    needed = plan["least_rp_l_mm"]
    if needed is not None and plan["assumed"]["rp_l_mm"] < needed:
        console.print(
            f"At all poses the verdict is `robot` from an RP_l of about {needed:.2g} mm on. A larger target in the "
            "image, a shorter distance or more tilt lowers the floor."
        )
    if plan["images_per_stop"] == 1:
        console.print(
            "With two images at each stop (--images-per-stop 2) the session measures its own noise floor, without a "
            "model of the noise; the two count as one cycle."
        )
    if plan["acceptance"]:
        shares = dict(plan["acceptance"])
        limit = shares.pop("datasheet_repeatability_mm")
        decided = ", ".join(f"{name} {share:.0%}" for name, share in shares.items())
        console.print(f"Decision on {limit:g} mm: {decided}")
