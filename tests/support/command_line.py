"""The client's commands in this process, against a running service."""

from __future__ import annotations

from typing import Any

from typer.testing import CliRunner, Result

from app.cli.main import app
from tests.support.service.service import environment_of


def gridpose(api: Any, *arguments: str, code: int = 0, stdin: str | None = None) -> Result:
    """Run a command in this process, where the server's log is printed too."""
    done = CliRunner().invoke(app, [*arguments, "--retry-timeout", "0"], env=environment_of(api), input=stdin)
    assert done.exit_code == code, done.output
    return done
