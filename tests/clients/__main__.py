"""`python -m tests.clients`: lint openapi.json, generate clients, and measure a session with each of them.

Everything it installs and writes is in build/clients, which git ignores; what is there already is used again.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

from app.cli.demo.service_process import ServiceProcess
from tests.clients.generation import java_client, lint, python_client, typescript_client
from tests.clients.session import write_session
from tests.clients.tools import WORK, CheckFailed, Tools, run

Result = TypeVar("Result")


def main() -> int:
    """Run every step and print how long it took; return the exit code."""
    WORK.mkdir(parents=True, exist_ok=True)
    tools = Tools()
    try:
        _step("install tools", tools.install)
        _step("lint openapi.json", lambda: lint(tools))
        clients = {
            "Python": _step("generate the Python client", lambda: python_client(tools)),
            "TypeScript": _step("generate the TypeScript client", lambda: typescript_client(tools)),
            "Java": _step("generate the Java client", lambda: java_client(tools)),
        }
        with tempfile.TemporaryDirectory() as folder:
            manifest = _step("render a session", lambda: write_session(Path(folder) / "images"))
            with ServiceProcess(Path(folder) / "data", {"GRIDPOSE_WORKERS": "2"}) as service:
                assert service.admin_key is not None
                for name, command in clients.items():
                    whole = [*command, service.url, service.admin_key, str(manifest)]
                    print(_step(f"measure with {name}", partial(run, whole)).out, end="", flush=True)
    except CheckFailed as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _step(name: str, work: Callable[[], Result]) -> Result:
    begin = time.monotonic()
    result = work()
    print(f"{time.monotonic() - begin:6.1f} s  {name}", flush=True)
    return result


if __name__ == "__main__":
    sys.exit(main())
