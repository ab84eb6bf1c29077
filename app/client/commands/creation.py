"""What the commands that create have in common: a name, a file with the body of the request, and the id as answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from .. import Json, ServiceClient
from ..http import insisting_query
from .console import OptionRefused, error_console
from .record_files import read_mapping

Name = Annotated[str | None, typer.Argument(help="What people call it; needed unless the file has it.")]
BodyFile = Annotated[
    Path | None,
    typer.Option(
        "--file",
        help="JSON or YAML with the fields of the API; options take precedence.",
        exists=True,
        dir_okay=False,
    ),
]

ChangesFile = Annotated[
    Path | None,
    typer.Option(
        "--file",
        help="JSON or YAML with what is new, under the names of the API; null removes; options take precedence.",
        exists=True,
        dir_okay=False,
    ),
]

AcceptImplausible = Annotated[
    bool,
    typer.Option(
        "--accept-implausible", help="Take values even if they look like another unit (metres, radians)."
    ),
]


def create_named(
    client: ServiceClient,
    noun: str,
    name: str | None,
    file: Path | None,
    fields: Callable[[ServiceClient], Json],
    needed: Mapping[str, str],
    next_command: str,
    *,
    accept_implausible: bool = False,
) -> None:
    """Make a resource of the service, from a file and from options, and print its id as the last line.

    Parameters
    ----------
    client
        The service's.
    noun
        What is made; its path is the plural.
    name, file
        As given.
    fields
        Returns the fields given by options; they take precedence over the file's.
    needed
        The fields without which the service refuses it, each with the option that gives it.
    next_command
        What to do with it, with `{id}`.
    accept_implausible
        Whether values are stored that look like another unit (`implausible_unit`).

    Raises
    ------
    OptionRefused
        The file cannot be read, or a field that is needed is given by neither.
    ClientError
        The service refuses it.
    """
    body = read_mapping(file) if file is not None else {}
    if name is not None:
        body["name"] = name
    body |= fields(client)
    missing = [option for field, option in {"name": "NAME", **needed}.items() if field not in body]
    if missing:
        raise OptionRefused(
            f"The {noun} is not described: {', '.join(missing)} missing.",
            f"Give it, or a --file; `gridpose {noun}s create --help` shows an example.",
        )
    made = client.create(f"/v1/{noun}s{insisting_query(accept_implausible)}", body)
    error_console().print(
        f"{noun} {escape(made['name'])} is made; next: {escape(next_command.format(id=made['id']))}"
    )
    print(made["id"])
