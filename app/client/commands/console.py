"""Messages of the command line on stderr, and its answers on stdout."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table


class OptionRefused(Exception):
    """Options or a file that a command cannot use; `advice` is the next action. The exit code is 2."""

    def __init__(self, detail: str, advice: str | None = None) -> None:
        super().__init__(detail)
        self.advice = advice


def number_of(count: int, noun: str) -> str:
    """Return a number of things in words: 1 image, 2 images."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def error_console() -> Console:
    """Return a console on stderr that breaks no line, so that paths and sentences stay whole in a log."""
    return Console(stderr=True, highlight=False, soft_wrap=True, emoji=False)


def output_console() -> Console:
    """Return a console on stdout for tables, which are not cut where nobody reads them on a screen."""
    console = Console(highlight=False, emoji=False)
    return console if console.is_terminal else Console(highlight=False, width=400, emoji=False)


def print_list(columns: Sequence[str], rows: Iterable[Sequence[str]], otherwise: str) -> None:
    """Print rows under their columns, the first of which holds ids and is never broken; without rows, `otherwise`."""
    table = Table(box=None, pad_edge=False)
    for place, column in enumerate(columns):
        table.add_column(column, no_wrap=place == 0, overflow="fold")
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    if table.row_count:
        output_console().print(table)
    else:
        print(otherwise)


def print_json(document: Any) -> None:
    """Print a document as JSON that a person can read."""
    print(json.dumps(document, indent=2, allow_nan=False))


def print_error(console: Console, detail: str, advice: str | None = None) -> None:
    """Print what failed, and what to do."""
    console.print(f"[red]{escape(detail)}[/]")
    if advice:
        console.print(escape(advice))


def confirm_deletion(question: str) -> None:
    """Ask whether to delete. Raises OptionRefused where nobody answers, ends the command where the answer is no."""
    try:
        agreed = typer.confirm(question, err=True)
    except typer.Abort:
        if sys.stdin.isatty():
            raise
        error_console().print()  # ends the line of the question
        raise OptionRefused("Nobody answered, and nothing was deleted.", "Give --yes to delete it.") from None
    if not agreed:
        fail("Nothing was deleted.")


def fail(detail: str, advice: str | None = None, *, code: int = 1) -> NoReturn:
    """Print what failed, and what to do; end the command with an exit code."""
    print_error(error_console(), detail, advice)
    raise typer.Exit(code)
