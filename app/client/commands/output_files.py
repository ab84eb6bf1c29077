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
        print_bytes(text.encode())
        return
    fresh = output.with_name(f".{output.name}.new")
    try:
        fresh.write_text(text, encoding="utf-8", newline="\n")
        fresh.replace(output)
    except OSError as error:
        raise OptionRefused(
            f"{output} cannot be written: {error.strerror}.", "Give a file in a folder that can be written."
        ) from error


def print_bytes(content: bytes) -> None:
    """Write a file's content to stdout, byte for byte, whatever the encoding of stdout."""
    if sys.stdout is None:  # as in a program without a console
        return
    sys.stdout.flush()
    sys.stdout.buffer.write(content)
    sys.stdout.buffer.flush()


def write_file(path: Path, content: bytes) -> None:
    """Write a file. Raises OptionRefused where it cannot be written."""
    try:
        path.write_bytes(content)
    except OSError as error:
        raise OptionRefused(f"{path} cannot be written: {error.strerror}.") from error
