"""Commands that are imported only when they run, so that `gridpose --help` and small commands start fast.

A command takes options that several share, declared once as a dataclass, as one parameter: an option group.
"""

from __future__ import annotations

import dataclasses
import functools
import gc
import importlib
import inspect
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, get_type_hints

import typer
from rich.markup import escape
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

_PANEL_COLUMNS = 130
"""Width from which on help is in panels: their columns cut options and examples where they are narrower."""


class LazyCommand(TyperCommand):
    """Stands for a command in its group; the command itself is imported to parse arguments, show help or run.

    `place` is "module:function". The function declares its own options, takes groups of shared ones, and returns the
    exit code.
    """

    def __init__(self, name: str, place: str, summary: str) -> None:
        super().__init__(name, help=summary)
        self.place = place

    def load(self) -> Any:
        """Import the command."""
        module, _, name = self.place.partition(":")
        holder = typer.Typer(add_completion=False, pretty_exceptions_show_locals=False)
        with uncollected():
            function = getattr(importlib.import_module(module), name)
        settings = getattr(function, "context_settings", None)
        holder.command(self.name, context_settings=settings)(_exiting(_expanded(function)))
        command: Any = get_command(holder)
        if _is_narrow():
            command.rich_markup_mode = None
            return command
        for described in (command, *command.params):
            if getattr(described, "help", None):
                described.help = escape(described.help)  # `[default: by its name]` is text and no style
        return command

    def make_context(self, *arguments: Any, **options: Any) -> Any:
        """Parse arguments by the imported command: whatever runs in this context is that command."""
        return self.load().make_context(*arguments, **options)


def lazy_group(commands: Mapping[str, tuple[str, str]]) -> type[TyperGroup]:
    """Return the class of a group of commands, each given by its name, place and summary."""
    lazy = {name: LazyCommand(name, place, summary) for name, (place, summary) in commands.items()}

    class LazyGroup(TyperGroup):
        def __init__(self, *, commands: Any = None, **attributes: Any) -> None:
            super().__init__(commands={**lazy, **(commands or {})}, **attributes)

        def format_help(self, context: Any, formatter: Any) -> None:
            if _is_narrow():
                super(TyperGroup, self).format_help(context, formatter)
            else:
                super().format_help(context, formatter)

        def format_commands(self, context: Any, formatter: Any) -> None:
            """Write every command with its whole summary."""
            with formatter.section("Commands"):
                formatter.write_dl([(name, command.help or "") for name, command in self.commands.items()])

    return LazyGroup


def _is_narrow() -> bool:
    return shutil.get_terminal_size().columns < _PANEL_COLUMNS


@contextmanager
def uncollected() -> Iterator[None]:
    """Leave modules to themselves: they stay to the end, and looking through them for garbage again and again takes a
    fifth of their import.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def _exiting(command: Callable[..., int | None]) -> Callable[..., None]:
    """Return a function with the same options that ends the process with the code `command` returns, 0 for none."""

    @functools.wraps(command)
    def run(*arguments: Any, **options: Any) -> None:
        raise typer.Exit(command(*arguments, **options) or 0)

    return run


def _expanded(command: Callable[..., int | None]) -> Callable[..., int | None]:
    """Return `command` with the options of its option groups, after its own, in place of the groups."""
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, tuple[type, tuple[str, ...]]] = {}
    own, shared = [], []
    for name, parameter in inspect.signature(command).parameters.items():
        kind = hints[name]
        if not dataclasses.is_dataclass(kind):
            own.append(parameter.replace(annotation=hints[name], kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        assert isinstance(kind, type)
        options = _options(kind)
        groups[name] = (kind, tuple(option.name for option in options))
        shared += options

    def run(**values: Any) -> int | None:
        for name, (kind, fields) in groups.items():
            values[name] = kind(**{field: values.pop(field) for field in fields})
        return command(**values)

    parameters = [*own, *shared]
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return run


def _options(group: type) -> list[inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if field.default is dataclasses.MISSING else field.default,
            annotation=hints[field.name],
        )
        for field in dataclasses.fields(group)
    ]
