"""The client's wheel in a fresh virtual environment, and a service to talk to."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.cli.demo.service_process import ServiceProcess

CLIENT = Path(__file__).parents[2] / "app" / "client"


@pytest.fixture(scope="session")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh virtual environment with the client's wheel and what it needs."""
    folder = tmp_path_factory.mktemp("client")
    build = ("wheel", "-q", "--no-deps", "--no-build-isolation", str(CLIENT), "-w", str(folder))
    subprocess.run([sys.executable, "-m", "pip", *build], check=True)
    (wheel,) = folder.glob("gridpose-*.whl")
    subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], check=True)
    programs = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
    subprocess.run([str(programs / "python"), "-m", "pip", "install", "-q", str(wheel)], check=True)
    return programs


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    with ServiceProcess(tmp_path_factory.mktemp("service") / "data", {"GRIDPOSE_WORKERS": "1"}) as process:
        yield process
