"""Every `gridpose …` command that a message, a help text or a page names exists, with the options named with it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import typer.main

from app.cli.main import app

PROJECT = Path(__file__).parents[2]
PAGES = [PROJECT / "README.md", *sorted((PROJECT / "docs").glob("*.md"))]
SOURCES = sorted(path for package in ("app", "core") for path in (PROJECT / package).rglob("*.py"))
NAMED = re.compile(r"`+(?:\.venv/bin/)?gridpose ([^`]+)`")
NAMING = [path for path in (*PAGES, *SOURCES) if NAMED.search(path.read_text(encoding="utf-8"))]


def found(words: list[str]) -> Any:
    """Return the command that words begin with; a group where they end with one."""
    command: Any = typer.main.get_command(app)
    for word in words:
        children = getattr(command, "commands", None)
        if children is None or word.startswith(("-", "<", "[")) or not re.fullmatch(r"[a-z][a-z-]+", word):
            break
        if word not in children:
            return None
        command = children[word]
    return command


@pytest.mark.parametrize("path", NAMING, ids=lambda path: str(path.relative_to(PROJECT)))
def test_named_commands_exist(path: Path) -> None:
    for text in NAMED.findall(path.read_text(encoding="utf-8")):
        words = text.split(" | ")[0].split()  # what follows is another program's
        command = found(words)
        assert command is not None, text
        if hasattr(command, "load"):
            options = {option for parameter in command.load().params for option in parameter.opts}
            named = {word.split("=")[0].strip("[](),.") for word in words if word.startswith("--")}
            assert named <= options | {"--help"}, text


def test_a_command_that_does_not_exist_is_seen() -> None:
    assert found(["import", "poses.csv"]) is None
    assert found(["targets", "draw"]) is None
    assert found(["targets", "print", "--kind"]) is not None
