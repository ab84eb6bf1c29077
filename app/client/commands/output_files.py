"""Files that commands write."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from .console import OptionRefused

Output = Annotated[Path | None, typer.Option("--output", "-o", help="File.  [default: stdout]")]


def write_text(text: str, output: Path | None) -> None:
    """Write an export, whole or not at all, to a file or to stdout. Raises OptionRefused where it cannot be written."""
    if output is None:
        sys.stdout.write(text)
        return
    fresh = output.with_name(f".{output.name}.new")
    try:
        fresh.write_text(text, encoding="utf-8", newline="\n")
        fresh.replace(output)
    except OSError as error:
        raise OptionRefused(
            f"{output} cannot be written: {error.strerror}.", "Give a file in a folder that can be written."
        ) from error


def write_file(path: Path, content: bytes) -> None:
    """Write a file. Raises OptionRefused where it cannot be written."""
    try:
        path.write_bytes(content)
    except OSError as error:
        raise OptionRefused(f"{path} cannot be written: {error.strerror}.") from error
