"""Where an export goes: a file, which is written whole or not at all, or stdout."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from ..console import OptionRefused

Output = Annotated[Path | None, typer.Option("--output", "-o", help="File.  [default: stdout]")]


def write_text(text: str, output: Path | None) -> None:
    """Write an export. Raises OptionRefused where the file cannot be written."""
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
