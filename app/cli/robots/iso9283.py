"""`gridpose robots plan iso9283`: the standard's test poses as files, and a forecast of the session."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from jaxtyping import Float
from rich.table import Table

from app.cli.console import OptionRefused, error_console, output_console, print_error
from app.cli.options.access import ReadAccess
from app.cli.robots.iso9283_runs import approach_poses, runs, sentences
from app.cli.targets.options import TargetOptions, choose_target
from app.client import ClientError, Json
from core import GridposeError, Lens
from core.geometry import Camera, invert, rotation_to_rpy, rpy_to_rotation, so3_exp, transform
from core.metrology import CYCLES, TEST_PLANES, VISITS, TestCube, VerdictLimits
from core.simulation import MAX_IMAGES_PER_STOP, Forecast, PlannedSession, forecast_repeatability

_ADDITIONAL_TILT = math.radians(25.0)
_ADDITIONAL = {"T1": (1.0, 0.0), "T2": (-1.0, 0.0), "T3": (0.0, 1.0), "T4": (0.0, -1.0)}
"""Four views in addition to the cube's, tilted about the camera's x and y axes: they determine lens and print."""
_FIELDS = ("pose_id", "position_mm", "roll_deg", "pitch_deg", "yaw_deg")


def plan_test(
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
            if path.suffix not in _WRITERS:
                raise OptionRefused(
                    f"{path.name} ends in no format that is written.", "Use .json, .csv or .pdf."
                )
        if not (0.0 < distance_mm < 1e6 and abs(tilt_deg) < 80.0):
            raise OptionRefused("The distance must be larger than 0 mm, the tilt below 80°.")
        cube = TestCube(_three("--centre-mm", centre_mm), side_mm, plane)
        R_base_flange = rpy_to_rotation(np.radians(_three("--orientation-deg", orientation_deg)))
        spec = choose_target(target, service).target
        focal_px = Lens(focal_length_mm, pixel_pitch_um).focal_px
        width, height = _size(image)
        camera = Camera(focal_px, focal_px, 0.5 * (width - 1), 0.5 * (height - 1), 0.0, 0.0, 0.0, 0.0)
        flange, additional = _flange_poses(cube, R_base_flange, distance_mm)
        middle = spec.points_target().mean(axis=0)
        stands = so3_exp(np.array([math.radians(tilt_deg), 0.0, 0.0]))
        ahead = np.array([0.0, 0.0, distance_mm])
        T_base_target = flange[0] @ transform(stands, ahead - stands @ middle)
        planned = PlannedSession(
            spec,
            camera,
            (width, height),
            np.array([invert(T) @ T_base_target for T in flange]),
            np.array([invert(T) @ T_base_target for T in additional]),
            cycles,
            corner_sigma_px,
            images_per_stop,
        )
        forecast = forecast_repeatability(planned, rp_mm, limit_mm=limit_mm)
        plan = _document(cube, flange, additional, planned, forecast, rp_mm, limit_mm)
        of_approach = approach_poses(plan["poses"], approaches, approach_mm)
        conditions = runs(load_kg or (), speed_percent or ())
        plan |= {"warm_up_min": warm_up_min, "runs": conditions, "approach_poses": of_approach}
        of_cycles = cycles * images_per_stop * (len(flange) + len(of_approach))
        plan["images"] = len(conditions) * (of_cycles + len(additional))
        for path in output or ():
            path.write_bytes(_WRITERS[path.suffix](plan))
    except OptionRefused as refused:
        print_error(error_console(), str(refused), refused.advice)
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


def _flange_poses(
    cube: TestCube, R_base_flange: Float[np.ndarray, "3 3"], distance_mm: float
) -> tuple[Float[np.ndarray, "5 4 4"], Float[np.ndarray, "4 4 4"]]:
    """Return T_base_flange of P1 to P5, and of the additional views, turned about the point before the camera at P1."""
    poses = np.array([transform(R_base_flange, p) for p in cube.positions_mm])
    ahead = np.array([0.0, 0.0, distance_mm])
    additional = []
    for about_x, about_y in _ADDITIONAL.values():
        R = so3_exp(_ADDITIONAL_TILT * np.array([about_x, about_y, 0.0]))
        additional.append(poses[0] @ transform(R, ahead - R @ ahead))
    return poses, np.array(additional)


def _document(
    cube: TestCube,
    flange: Float[np.ndarray, "5 4 4"],
    additional: Float[np.ndarray, "4 4 4"],
    planned: PlannedSession,
    forecast: Forecast,
    rp_mm: float,
    limit_mm: float | None,
) -> Json:
    names = [f"P{k + 1}" for k in range(len(flange))]
    return {
        "standard": "ISO 9283:1998",
        "cube": {
            "centre_mm": list(cube.centre_mm),
            "side_mm": cube.side_mm,
            "plane": cube.plane,
            "corners_mm": {f"C{k + 1}": corner for k, corner in enumerate(cube.corners_mm.tolist())},
        },
        "poses": [_pose(name, T) for name, T in zip(names, flange, strict=True)],
        "additional_poses": [_pose(name, T) for name, T in zip(_ADDITIONAL, additional, strict=True)],
        "cycles": planned.cycles,
        "order_of_a_cycle": list(VISITS),
        "images_per_stop": planned.images_per_stop,
        "assumed": {
            "rp_l_mm": rp_mm,
            "corner_sigma_px": planned.corner_sigma_px,
            "focal_px": planned.camera.fx_px,
            "image_px": list(planned.size_px),
        },
        "forecast": [
            {
                "pose_id": name,
                "in_view": one.in_view,
                "noise_floor_mm": one.floor_mm if one.in_view else None,
                "rp_l_mm": one.reading_mm if one.in_view else None,
                "interval_mm": list(one.interval_mm) if one.in_view else None,
                "verdicts": dict(one.verdicts),
            }
            for name, one in zip(names, forecast.poses, strict=True)
        ],
        "acceptance": None
        if forecast.decisions is None
        else {"datasheet_repeatability_mm": limit_mm, **forecast.decisions},
    }


def _pose(name: str, T: Float[np.ndarray, "4 4"]) -> dict[str, Any]:
    angles = np.degrees(rotation_to_rpy(T[:3, :3])).round(6) + 0.0
    return dict(zip(_FIELDS, (name, (T[:3, 3].round(6) + 0.0).tolist(), *angles.tolist()), strict=True))


def _json(plan: Json) -> bytes:
    return json.dumps(plan, indent=2, allow_nan=False).encode() + b"\n"


def _csv(plan: Json) -> bytes:
    file = io.StringIO(newline="")
    table = csv.writer(file)
    table.writerow(["pose_id", "x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg", "approach"])
    for pose in (*plan["poses"], *plan["approach_poses"], *plan["additional_poses"]):
        angles = (pose[name] for name in _FIELDS[2:])
        table.writerow([pose["pose_id"], *pose["position_mm"], *angles, pose.get("approach", "")])
    return file.getvalue().encode()


def _pdf(plan: Json) -> bytes:
    from app.reports.check_list import draw_check_list  # loads matplotlib

    return draw_check_list(plan)


_WRITERS = {".json": _json, ".csv": _csv, ".pdf": _pdf}


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
    floors = [one["noise_floor_mm"] for one in plan["forecast"] if one["in_view"]]
    needed = max(floors) / VerdictLimits().instrument_share
    if plan["assumed"]["rp_l_mm"] < needed:
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
