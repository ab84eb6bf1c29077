"""A PC next to a robot, which has the client's package alone."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path


class ShopFloor:
    """A PC with the client alone: its programs, run in a folder with this service's address."""

    def __init__(self, programs: Path, folder: Path, url: str) -> None:
        self.programs, self.folder = programs, folder
        self.variables = {
            name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "GRIDPOSE"))
        }
        self.variables |= {
            "GRIDPOSE_URL": url,
            "XDG_CONFIG_HOME": str(folder),
            "XDG_STATE_HOME": str(folder),
        }

    def start(self, *words: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [str(self.programs / words[0]), *words[1:]],
            cwd=self.folder,
            env=self.variables,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *words: str, text: str | None = None, code: int = 0) -> str:
        """Run a program to its end and return what it said, on stderr where it was to fail."""
        with self.start(*words) as process:
            said, errors = process.communicate(text, timeout=300)
        assert process.returncode == code, said + errors
        return errors if code else said
