"""The `gridpose` command: made from the table of commands; with the service installed, its commands are among them."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
from collections.abc import Callable, Mapping
from importlib.metadata import entry_points

import typer

from .lazy import lazy_group
from .table import CLIENT, GROUPS, SERVICE

_CLOSED_PIPE = (errno.EPIPE, errno.EINVAL) if sys.platform == "win32" else (errno.EPIPE,)
"""Errors of a pipe that is closed downstream."""
_ABSENT = ".absent:explain"


def make_app(service: Mapping[str, str] | None = None, version: str | None = None) -> typer.Typer:
    """Return the command line.

    Parameters
    ----------
    service
        Command of the service to "module:function"; None where the service is not installed: its commands then say how
        to get it.
    version
        "module:function" of `gridpose version`; None for the client's.
    """
    places = {name: (_here(place), summary) for name, (place, summary) in CLIENT.items()}
    places["version"] = (
        version or _here(".version:show_version"),
        "Print the installed version and build.",
    )
    for name, summary in SERVICE.items():
        if service is None:
            places[name] = (_here(_ABSENT), f"{summary} Needs gridpose[server].")
        else:
            places[name] = (service[name], summary)
    root = typer.Typer(
        name="gridpose",
        help="Remote robot metrology: calibrated 6-D camera poses from single images of a printed grid.",
        cls=lazy_group(_of_group("", places)),
        no_args_is_help=True,
        pretty_exceptions_show_locals=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    groups = {"": root}
    for name, text in GROUPS.items():
        groups[name] = typer.Typer(help=text, cls=lazy_group(_of_group(name, places)), no_args_is_help=True)
        parent, _, last = name.rpartition(" ")
        groups[parent].add_typer(groups[name], name=last)
    return root


def run(app: Callable[[], None] | None = None) -> None:
    """Run a command line.

    Characters that stdout or stderr cannot encode are printed as `?`. Where stdout cannot be written, the exit code is
    1; a closed pipe downstream (`gridpose sessions list | head`) ends it quietly.

    Without `app`: that of the service where it is installed, which has the client's commands, too; else the client's.
    """
    if app is None:
        for entry in entry_points(group="gridpose.service"):
            entry.load()()
            return
        app = make_app()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # it is None in a program without a console
            stream.reconfigure(errors="replace")
    rest = ""
    try:
        app()
    except OSError:
        rest = "\n"  # fails again where stdout is the cause
        raise
    finally:
        _finish_output(rest)


def _finish_output(rest: str) -> None:
    """Write what is left for stdout; where that fails, end the process with a message in place of a traceback."""
    try:
        if sys.stdout is not None:
            sys.stdout.write(rest)
            sys.stdout.flush()
    except OSError as error:
        with contextlib.suppress(OSError, ValueError):  # else the interpreter fails again on it when it exits
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno not in _CLOSED_PIPE:
            from .console import error_console, print_error  # which most starts of the command do not need

            print_error(
                error_console(),
                f"The output cannot be written: {error.strerror or error}.",
                "Make room there, or send the output elsewhere.",
            )
        sys.exit(1)


def _here(place: str) -> str:
    """Return a place of this package with the package's name, which differs where the client is installed alone."""
    assert __package__
    return f"{__package__}{place}"


def _of_group(group: str, places: Mapping[str, tuple[str, str]]) -> dict[str, tuple[str, str]]:
    """Return the commands of one group by their last words, in the table's order."""
    split = {name: name.rpartition(" ") for name in places}
    return {split[name][2]: place for name, place in places.items() if split[name][0] == group}
