"""Names, options and help of every subcommand; what they do stands in the module of the same name."""

from __future__ import annotations

import enum
import os
import sys
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Annotated

import typer

from app.cli.robot_commands import export, import_, plan
from app.cli.target_commands import target

app = typer.Typer(
    name="gridpose",
    help="Remote robot metrology: calibrated 6-D camera poses from single images of a printed grid.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_show_locals=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
keys = typer.Typer(
    help="Make, list and revoke API keys, with or without a running service.", no_args_is_help=True
)
app.add_typer(keys, name="keys")
app.add_typer(export, name="export")
app.add_typer(plan, name="plan")
app.add_typer(target, name="target")

DataDir = Annotated[
    Path | None,
    typer.Option(
        "--data-dir", help="Folder of the service's data.  [default: GRIDPOSE_DATA_DIR, else the user's]"
    ),
]


class Scope(enum.StrEnum):
    """What a key may do; each includes the one before it."""

    read = "read"
    upload = "upload"
    admin = "admin"


@app.command()
def serve(
    host: Annotated[
        str | None, typer.Option(help="Address to listen on.  [default: GRIDPOSE_HOST, 127.0.0.1]")
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(help="0 takes any free port.  [default: GRIDPOSE_PORT, 8000]", min=0, max=65535),
    ] = None,
    data_dir: DataDir = None,
) -> None:
    """Run the service: HTTP, and GRIDPOSE_WORKERS worker processes beside it (default: one a core)."""
    from app.cli.serve import serve as run

    raise typer.Exit(run(host, port, data_dir))


@app.command()
def worker(data_dir: DataDir = None) -> None:
    """Compute queued images without serving HTTP."""
    from app.cli.worker import work as run

    raise typer.Exit(run(data_dir))


@keys.command("create")
def keys_create(
    name: Annotated[str, typer.Argument(help="Whom or what the key is for; shown in lists.")],
    scope: Annotated[
        Scope, typer.Option(help="read: GET. upload: read, and all that adds. admin: everything.")
    ] = Scope.upload,
    days: Annotated[
        int | None, typer.Option(help="Valid for so many days.  [default: until revoked]", min=1, max=36500)
    ] = None,
    data_dir: DataDir = None,
) -> None:
    """Make a key and print it, this once, as the last line."""
    from app.cli.keys import create

    raise typer.Exit(create(name, scope.value, days, data_dir))


@keys.command("list")
def keys_list(data_dir: DataDir = None) -> None:
    """Show names, scopes and dates of all keys; never the keys themselves."""
    from app.cli.keys import show

    raise typer.Exit(show(data_dir))


@keys.command("revoke")
def keys_revoke(
    key_id: Annotated[str, typer.Argument(help="The key's id, as `keys list` shows it.")],
    data_dir: DataDir = None,
) -> None:
    """End a key's validity at once and for ever."""
    from app.cli.keys import revoke

    raise typer.Exit(revoke(key_id, data_dir))


@app.command()
def doctor(data_dir: DataDir = None) -> None:
    """Check this installation and its data folder, and say what to do about each finding."""
    from app.cli.doctor import examine as run

    raise typer.Exit(run(data_dir))


@app.command()
def upload(
    folder: Annotated[
        Path, typer.Argument(help="Folder of images; sub-folders are poses.", exists=True, file_okay=False)
    ],
    session: Annotated[
        str, typer.Option(help="Id or name of the session; a new name is made, given --target.")
    ],
    url: Annotated[
        str, typer.Option(envvar="GRIDPOSE_URL", help="Where the service is.")
    ] = "http://127.0.0.1:8000",
    key: Annotated[str | None, typer.Option(envvar="GRIDPOSE_KEY", help="API key of scope upload.")] = None,
    target: Annotated[
        str | None,
        typer.Option(help="Target's id, or a new one as KIND:COLUMNSxROWS:PITCH_MM, e.g. chessboard:9x6:25."),
    ] = None,
    pattern: Annotated[
        str | None,
        typer.Option(
            help="Where pose and cycle stand in the path, e.g. '{pose}_{cycle}' or '{any}/{pose}-{cycle}'."
        ),
    ] = None,
    pose: Annotated[str | None, typer.Option(help="Pose ID of all files.")] = None,
    focus_group: Annotated[str | None, typer.Option(help="Tag of images taken at one focus setting.")] = None,
    parallel: Annotated[int, typer.Option(help="Uploads at a time.", min=1, max=16)] = 2,
    retry_for: Annotated[
        float, typer.Option(help="Seconds to go on trying while the service is away.", min=0)
    ] = 300.0,
    wait: Annotated[
        bool, typer.Option("--wait", help="Wait for the results and list the images refused.")
    ] = False,
) -> None:
    """Send a folder's images to a session, once each; run it again to go on after an interruption.

    Ends with 0 when every image is stored (and, with --wait, calibrated), else with 1 and a list.
    """
    from app.cli.upload import Request
    from app.cli.upload import upload as run

    request = Request(
        folder, session, url, key, target, pattern, pose, focus_group, parallel, retry_for, wait
    )
    raise typer.Exit(run(request))


app.command("import")(import_)


@app.command()
def demo(
    data_dir: Annotated[
        Path | None, typer.Option(help="Keep the session here.  [default: a new temporary folder]")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the rendered session.")] = 1,
    quick: Annotated[
        bool, typer.Option("--quick", help="Half the pixels in each direction, half the cycles, fewer poses.")
    ] = False,
) -> None:
    """Run the paper's experiment with known truth through the real service, and compare."""
    from app.cli.demo import demonstrate as run

    raise typer.Exit(run(data_dir, seed, quick))


@app.command()
def version() -> None:
    """Print the installed version."""
    typer.echo(installed_version("gridpose"))


def main() -> None:
    """Run the command line; a closed pipe downstream (`gridpose keys list | head`) ends it quietly."""
    try:
        app()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
