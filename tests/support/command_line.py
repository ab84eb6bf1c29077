"""Commands in this process: those of the client against a running service, and those of the service itself."""

from __future__ import annotations

import os
import subprocess
import traceback
from typing import Any

from typer.testing import CliRunner, Result

from app.cli.demo.service_process import ServiceProcess
from app.cli.main import app
from tests.support.service.service import environment_of


def gridpose(api: Any, *arguments: str, code: int = 0, stdin: str | None = None) -> Result:
    """Run a command in this process, where the server's log is printed too."""
    done = CliRunner().invoke(app, [*arguments, "--retry-timeout", "0"], env=environment_of(api), input=stdin)
    assert done.exit_code == code, done.output
    return done


def gridpose_here(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command in this process, and return its end as `tests.support.service.service.gridpose` does.

    A process of its own takes .5 to 1 s of processor time before it does anything.
    """
    umask = os.umask(0o077)
    os.umask(umask)
    try:
        done = CliRunner().invoke(app, arguments, env={"COLUMNS": "200", "NO_COLOR": "1", **environment})
    finally:
        os.umask(umask)  # commands of the service set it
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise AssertionError("".join(traceback.format_exception(done.exception)))
    assert "Traceback" not in done.output, done.output
    return subprocess.CompletedProcess(arguments, done.exit_code, done.stdout, done.stderr)


def run_here_at(service: ServiceProcess, *arguments: str) -> tuple[int, str, str]:
    """Run a command in this process against a service; return exit code, output and errors."""
    ended = gridpose_here(*arguments, GRIDPOSE_URL=service.url, GRIDPOSE_KEY=service.admin_key or "")
    return ended.returncode, ended.stdout.strip(), ended.stderr
