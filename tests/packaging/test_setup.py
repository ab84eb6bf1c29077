"""`make setup` does what has changed: packages, and kernels of another version with the same packages."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout with one kernel, whose environment is there and whose commands do nothing."""
    shutil.copy(PROJECT / "Makefile", tmp_path)
    for name in ("requirements.txt", "pyproject.toml", "app/client/pyproject.toml", "core/kernel.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    python = tmp_path / ".venv" / "bin" / "python"
    python.write_text("#!/bin/sh\n")
    python.chmod(0o755)
    (tmp_path / ".venv" / "bin" / ".setup").touch()
    return tmp_path


def compiles(checkout: Path) -> bool:
    said = subprocess.run(
        ["make", "setup"], cwd=checkout, capture_output=True, text=True, check=True, timeout=240.0
    )
    return "app.jobs.warm_up" in said.stdout


def test_kernels_are_compiled_where_core_changed_however_old_its_files_are(checkout: Path) -> None:
    kernel = checkout / "core" / "kernel.py"
    assert compiles(checkout)
    assert not compiles(checkout)
    kernel.touch()
    assert not compiles(checkout)
    former = kernel.read_text()
    for content in ("of another version", former):  # there and back
        kernel.write_text(content)
        os.utime(kernel, (0, 0))
        assert compiles(checkout)
        assert not compiles(checkout)
