"""Names, options and help of the subcommands about robots: import, export and plan; what they do stands elsewhere."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer

export = typer.Typer(
    help="Write what a session's analyses found as files of other programs.", no_args_is_help=True
)
plan = typer.Typer(help="Predict what measurements would tell before they are made.", no_args_is_help=True)


class ModelFormat(enum.StrEnum):
    """Files a robot is written as."""

    urdf = "urdf"
    rtb = "rtb"
    yaml = "yaml"
    csv = "csv"


class DhMethod(enum.StrEnum):
    """How a robot is identified."""

    cpa = "cpa"
    screw = "screw"
    combined = "combined"
    global_ = "global"


class DhSource(enum.StrEnum):
    """Where a session's poses come from."""

    images = "images"
    measured_poses = "measured_poses"


@export.command("dh")
def export_dh(
    session: Annotated[str, typer.Option(help="Id or name of the session.")],
    model_format: Annotated[
        ModelFormat,
        typer.Option(
            "--format", help="rtb: Python for Peter Corke's Robotics Toolbox. csv: one row a joint."
        ),
    ],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File.  [default: stdout]")] = None,
    url: Annotated[
        str, typer.Option(envvar="GRIDPOSE_URL", help="Where the service is.")
    ] = "http://127.0.0.1:8000",
    key: Annotated[str | None, typer.Option(envvar="GRIDPOSE_KEY", help="API key of scope read.")] = None,
    method: Annotated[DhMethod, typer.Option(help="As of the analysis.")] = DhMethod.global_,
    source: Annotated[
        DhSource, typer.Option(help="Poses from images, or of another instrument.")
    ] = DhSource.images,
    estimator: Annotated[str, typer.Option(help="As of the analysis.")] = "pooled",
    joint_tolerance_deg: Annotated[
        float | None, typer.Option(help="How far resting joints may differ within a sweep.")
    ] = None,
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            help="JOINT:POSE,POSE,... names a sweep by its poses, with * and ? as patterns; as often as there are such."
        ),
    ] = None,
    joint_names: Annotated[
        str | None,
        typer.Option(help="Names of the joints, by commas.  [default: the robot's own, or joint_1, ...]"),
    ] = None,
    joint_limits: Annotated[
        str | None,
        typer.Option(
            help="LOW:HIGH in degrees for each joint, by commas.  [default: the robot's own; else they turn freely]"
        ),
    ] = None,
    camera: Annotated[
        bool, typer.Option(help="With the camera (or probe) as a link of the URDF, where it was found.")
    ] = True,
    retry_for: Annotated[
        float, typer.Option(help="Seconds to go on trying while the service is away.", min=0)
    ] = 300.0,
) -> None:
    """Write a session's identified robot as URDF, Robotics Toolbox model, YAML or CSV."""
    from app.cli.export_dh import Request
    from app.cli.export_dh import export_dh as run

    request = Request(
        session=session,
        kind=model_format.value,
        output=output,
        url=url,
        key=key,
        method=method.value,
        source=source.value,
        estimator=estimator,
        joint_tolerance_deg=joint_tolerance_deg,
        sweeps=tuple(sweep or ()),
        names=joint_names,
        limits=joint_limits,
        camera=camera,
        retry_for_s=retry_for,
    )
    raise typer.Exit(run(request))


@plan.command("dh")
def plan_dh(
    file: Annotated[
        Path,
        typer.Argument(
            help="YAML or JSON with target_id, camera, home_deg, sweeps, ... as POST .../dh-plan takes them.",
            exists=True,
            dir_okay=False,
        ),
    ],
    robot: Annotated[str, typer.Option(help="Id or name of the robot.")],
    url: Annotated[
        str, typer.Option(envvar="GRIDPOSE_URL", help="Where the service is.")
    ] = "http://127.0.0.1:8000",
    key: Annotated[str | None, typer.Option(envvar="GRIDPOSE_KEY", help="API key of scope upload.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the service's answer as it is.")] = False,
    retry_for: Annotated[
        float, typer.Option(help="Seconds to go on trying while the service is away.", min=0)
    ] = 300.0,
) -> None:
    """Predict the uncertainty of every DH parameter for a set of poses, and suggest the poses that help most."""
    from app.cli.plan_dh import Request
    from app.cli.plan_dh import plan_dh as run

    request = Request(file=file, robot=robot, url=url, key=key, as_json=as_json, retry_for_s=retry_for)
    raise typer.Exit(run(request))


class Lengths(enum.StrEnum):
    """Units of coordinates."""

    mm = "mm"
    m = "m"
    inch = "in"


class Angles(enum.StrEnum):
    """Units of angles."""

    deg = "deg"
    rad = "rad"


class RecordFormat(enum.StrEnum):
    """Files that readings come in."""

    csv = "csv"
    json = "json"
    yaml = "yaml"


def import_(
    file: Annotated[
        Path, typer.Argument(help="CSV, JSON or YAML file of readings.", exists=True, dir_okay=False)
    ],
    session: Annotated[
        str | None, typer.Option(help="Id or name of the session; a new name is made, given --target.")
    ] = None,
    url: Annotated[
        str, typer.Option(envvar="GRIDPOSE_URL", help="Where the service is.")
    ] = "http://127.0.0.1:8000",
    key: Annotated[str | None, typer.Option(envvar="GRIDPOSE_KEY", help="API key of scope upload.")] = None,
    target: Annotated[
        str | None,
        typer.Option(help="Target of a new session: an id, or KIND:COLUMNSxROWS:PITCH_MM."),
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(
            help="FIELD=COLUMN, as often as needed: pose, cycle, joints (several columns, by commas), x, y, z, "
            "rx, ry, rz (or r1, r2, r3), qx, qy, qz, qw, and u_x ... for standard uncertainties."
        ),
    ] = None,
    rotation: Annotated[
        str | None,
        typer.Option(
            help="What angles mean: the order of the product, xyz for Rx Ry Rz, zyx for roll, pitch, yaw; or vector."
        ),
    ] = None,
    lengths: Annotated[Lengths, typer.Option(help="Unit of coordinates.")] = Lengths.mm,
    angles: Annotated[Angles, typer.Option(help="Unit of orientations' angles.")] = Angles.deg,
    joint_angles: Annotated[Angles, typer.Option(help="Unit of joint angles.")] = Angles.deg,
    file_format: Annotated[
        RecordFormat | None, typer.Option("--format", help="Kind of file.  [default: by its name]")
    ] = None,
    delimiter: Annotated[
        str | None, typer.Option(help="Between a CSV's columns, or tab.  [default: by the first line]")
    ] = None,
    decimal: Annotated[
        str | None, typer.Option(help="Decimal sign of a CSV, . or ,  [default: by the numbers]")
    ] = None,
    prefix: Annotated[str, typer.Option(help="Before the number, for pose IDs of unnamed readings.")] = "r",
    skip_invalid: Annotated[
        bool, typer.Option("--skip-invalid", help="Send the sound readings and leave out the others.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Read, check and show the first reading; send nothing.")
    ] = False,
    retry_for: Annotated[
        float, typer.Option(help="Seconds to go on trying while the service is away.", min=0)
    ] = 300.0,
) -> None:
    """Send poses that a laser tracker or another instrument measured to a session; again changes nothing.

    Ends with 0 when all are stored, 1 when some are refused (with their lines), 2 when the file cannot be read so.
    """
    from app.cli.import_poses import Request, import_poses

    request = Request(
        file=file,
        session=session,
        url=url,
        key=key,
        target=target,
        kind=file_format.value if file_format else None,
        columns=tuple(column or ()),
        rotation=rotation,
        lengths=lengths.value,
        angles=angles.value,
        joint_angles=joint_angles.value,
        delimiter=delimiter,
        decimal=decimal,
        prefix=prefix,
        skip=skip_invalid,
        dry_run=dry_run,
        retry_for_s=retry_for,
    )
    raise typer.Exit(import_poses(request))
