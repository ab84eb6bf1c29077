"""Names and options that look like the short names of emoji are printed as they are."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from app.client.commands.console import print_list

APP = Path(__file__).parents[4] / "app"


def test_colons_stay_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    print_list(("id", "name"), [("s", "q :b: 180:100:x")], "")
    assert "q :b: 180:100:x" in capsys.readouterr().out


@pytest.mark.parametrize("package", ["client", "cli"])
def test_no_console_replaces_colons(package: str) -> None:
    for path in (APP / package).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Console":
                assert "emoji" in {keyword.arg for keyword in node.keywords}, f"{path}:{node.lineno}"
