"""The `gridpose` command: every subcommand by its name, the function that implements it, and its summary.

The functions declare their options. Their modules are imported only when they run: `gridpose upload` starts on a
shop-floor PC without loading the service's database or job runner.
"""

from __future__ import annotations

import os
import sys

import typer

from app.cli.lazy import lazy_group

app = typer.Typer(
    name="gridpose",
    help="Remote robot metrology: calibrated 6-D camera poses from single images of a printed grid.",
    cls=lazy_group(
        {
            "serve": (
                "app.cli.server.serve:serve",
                "Run the service: HTTP, and GRIDPOSE_WORKERS worker processes (default: one a core).",
            ),
            "worker": (
                "app.cli.server.worker:work",
                "Compute queued images without serving HTTP.",
            ),
            "qualify": (
                "app.cli.qualify:qualify",
                "Compare known lengths between poses of a session with what it measured of them.",
            ),
            "doctor": (
                "app.cli.doctor.command:doctor",
                "Check this installation and its data folder, with advice for each problem found.",
            ),
            "backup": (
                "app.cli.server.backup:back_up",
                "Copy database, originals and pepper, all of one moment, while the service runs.",
            ),
            "restore": (
                "app.cli.server.backup:restore",
                "Restore a backup into an empty data folder and an empty database.",
            ),
            "upload": (
                "app.cli.upload:upload",
                "Send a folder's images to a session, once each; repeat it to continue after an interruption.",
            ),
            "demo": (
                "app.cli.demo.options:demo",
                "Run a small rendered session with known truth through the real service, and compare.",
            ),
            "version": (
                "app.cli.main:version",
                "Print the installed version and build.",
            ),
        }
    ),
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_show_locals=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
keys = typer.Typer(
    help="Create, list and revoke API keys, with or without a running service.",
    cls=lazy_group(
        {
            "create": (
                "app.cli.server.keys:create",
                "Create a key and print it, this once, as the last line.",
            ),
            "list": (
                "app.cli.server.keys:show",
                "Show names, scopes and dates of all keys; never the keys themselves.",
            ),
            "revoke": (
                "app.cli.server.keys:revoke",
                "Revoke a key, at once and permanently.",
            ),
        }
    ),
    no_args_is_help=True,
)
schema = typer.Typer(
    help="Show the schema of the database, and downgrade it before an older version is installed.",
    cls=lazy_group(
        {
            "show": (
                "app.cli.server.schema:show",
                "Show the database's schema, this version's, and the earlier ones it can be downgraded to.",
            ),
            "downgrade": (
                "app.cli.server.schema:downgrade",
                "Downgrade the database to an earlier schema, for an older version; a copy is made first.",
            ),
        }
    ),
    no_args_is_help=True,
)
robots = typer.Typer(
    help="Make, show and delete the robots of a service; write an identified one as a file; plan an identification.",
    cls=lazy_group(
        {
            "export": (
                "app.cli.robots.export:export_dh",
                "Write a session's identified robot as URDF, Robotics Toolbox model, YAML or CSV.",
            ),
            "create": (
                "app.cli.robots.creation:create",
                "Make a robot with its nominal Denavit-Hartenberg parameters.",
            ),
            "change": (
                "app.cli.robots.creation:change",
                "Change what is stated of a robot; joints are given whole.",
            ),
            "list": ("app.cli.robots.stored:show_list", "List the robots of a service."),
            "delete": ("app.cli.robots.stored:delete", "Delete robots that no session names."),
        }
    ),
    no_args_is_help=True,
)
robots.add_typer(
    typer.Typer(
        help="Plan a measurement before the robot moves: an identification, or a test of repeatability.",
        cls=lazy_group(
            {
                "dh": (
                    "app.cli.robots.plan:plan_dh",
                    "Predict the uncertainty of every DH parameter for a set of poses, and suggest the poses that "
                    "help most.",
                ),
                "iso9283": (
                    "app.cli.robots.iso9283:plan_test",
                    "Write the standard's test poses, and predict floor, intervals and verdicts of the session.",
                ),
            }
        ),
        no_args_is_help=True,
    ),
    name="plan",
)
measured_poses = typer.Typer(
    help="Poses that a laser tracker or another instrument measured.",
    cls=lazy_group(
        {
            "import": (
                "app.cli.measured_poses.command:import_poses",
                "Send poses measured by a laser tracker or another instrument to a session; repeating changes "
                "nothing.",
            ),
            "delete": (
                "app.cli.measured_poses.deletion:delete",
                "Delete poses that another instrument measured: those of a pose, of a cycle, of both, or all.",
            ),
        }
    ),
    no_args_is_help=True,
)
targets = typer.Typer(
    help="Print a target and check a printed one; make, show and delete those of a service.",
    cls=lazy_group(
        {
            "print": (
                "app.cli.targets.pdf:print_target",
                "Draw a target at true scale as PDF or SVG, with rulers along two sides and its own id.",
            ),
            "check": (
                "app.cli.targets.check:check_target",
                "Determine from photographs how a print differs from its description: stretch, squareness, flatness.",
            ),
            "create": (
                "app.cli.targets.creation:create",
                "Make a target: what is printed, how many grid points it has, and their distance.",
            ),
            "list": ("app.cli.targets.stored:show_list", "List the targets of a service."),
            "delete": (
                "app.cli.targets.stored:delete",
                "Delete targets that no session and no measurement refers to.",
            ),
        }
    ),
    no_args_is_help=True,
)
measurements = typer.Typer(
    help="Show what came of images, and correct what was said about them.",
    cls=lazy_group(
        {
            "list": (
                "app.cli.measurements.listing:show_list",
                "List a session's measurements with their ids, why they failed, and why they are excluded.",
            ),
            "show": (
                "app.cli.measurements.listing:show",
                "Print a measurement as the service answers it.",
            ),
            "correct": (
                "app.cli.measurements.changes:correct",
                "Correct the pose, cycle, focus group or joint angles of an image, in all of its measurements.",
            ),
            "exclude": (
                "app.cli.measurements.changes:exclude",
                "Exclude measurements from analyses, which list them with the reason.",
            ),
            "include": (
                "app.cli.measurements.changes:include",
                "Let measurements count again that were excluded from analyses.",
            ),
            "delete": (
                "app.cli.measurements.changes:delete",
                "Delete measurements with their results, and originals that no other measurement holds.",
            ),
            "retry": (
                "app.cli.measurements.changes:retry",
                "Compute measurements again; their results stay until others replace them.",
            ),
        }
    ),
    no_args_is_help=True,
)
sessions = typer.Typer(
    help="Make, show, change and delete the sessions of a service, and compute them again.",
    cls=lazy_group(
        {
            "create": (
                "app.cli.sessions.creation:create",
                "Begin a session: one camera looking at one or more targets.",
            ),
            "list": (
                "app.cli.sessions.listing:show_list",
                "List the sessions of a service, with the numbers of their measurements.",
            ),
            "show": ("app.cli.sessions.listing:show", "Print a session as the service answers it."),
            "change": (
                "app.cli.sessions.changes:change",
                "Change a session's targets, robot or name; images whose target went are searched again.",
            ),
            "reprocess": (
                "app.cli.sessions.changes:reprocess",
                "Compute a session's failed measurements again, or all; results stay until others replace them.",
            ),
            "delete": ("app.cli.sessions.changes:delete", "Delete a session with everything in it."),
        }
    ),
    no_args_is_help=True,
)
poses = typer.Typer(
    help="The commanded poses of a session.",
    cls=lazy_group(
        {
            "load": (
                "app.cli.sessions.poses:load",
                "Store the commanded poses of a file in a session, all or none; a pose that is there is replaced "
                "whole.",
            ),
        }
    ),
    no_args_is_help=True,
)
for group, name in (
    (keys, "keys"),
    (schema, "schema"),
    (robots, "robots"),
    (poses, "poses"),
    (measured_poses, "measured-poses"),
    (targets, "targets"),
    (measurements, "measurements"),
    (sessions, "sessions"),
):
    app.add_typer(group, name=name)


def version() -> int:
    """Print the installed version and build."""
    from app.build import core_version  # it reads the package's metadata, which `--help` does not need

    typer.echo(core_version())
    return 0


def main() -> None:
    """Run the command line; a closed pipe downstream (`gridpose keys list | head`) ends it quietly."""
    try:
        app()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
