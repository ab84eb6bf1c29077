"""What a command of the service says where only the client is installed."""

from __future__ import annotations

from typing import Annotated

import typer

from .console import error_console, print_error


def explain(
    context: typer.Context,
    arguments: Annotated[list[str] | None, typer.Argument(help="Ignored.", hidden=True)] = None,
) -> int:
    """This command belongs to the service, which is not installed here."""
    name = context.info_name or ""
    print_error(
        error_console(),
        f"`{name}` is a command of the service, which is not installed here: this is the client alone.",
        "Install the service in an environment of its own: pip install 'gridpose[server]'. On a shop-floor PC "
        "the client is enough: gridpose watch, upload, sessions, targets, poses.",
    )
    return 2


explain.context_settings = {"ignore_unknown_options": True, "allow_extra_args": True}  # type: ignore[attr-defined]
