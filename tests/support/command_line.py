"""The client's commands in this process, against a running service."""

from __future__ import annotations

from typing import Any

from typer.testing import CliRunner, Result

from app.cli.main import app


def gridpose(api: Any, *arguments: str, code: int = 0) -> Result:
    """Run a command in this process."""
    key = api.client.headers["authorization"].removeprefix("Bearer ")
    settings = {"GRIDPOSE_URL": str(api.client.base_url), "GRIDPOSE_KEY": key}
    done = CliRunner().invoke(app, [*arguments, "--retry-timeout", "0"], env=settings)
    assert done.exit_code == code, done.output
    return done
