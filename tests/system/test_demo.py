"""`gridpose demo` from start to end, on a narrow terminal."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest


def demo(folder: Path, columns: int) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "app.cli", "demo", "--data-dir", str(folder), "--seed", "2"],
        env={**os.environ, "COLUMNS": str(columns), "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.mark.slow
def test_it_calibrates_refuses_and_tells_the_truth(tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    ended = demo(folder, 80)
    said = ended.stdout
    assert ended.returncode == 0, said + ended.stderr
    assert "15 images calibrated, 1 refused" in " ".join(said.split())
    assert "focal_not_observable" in said
    tables, where = said.split("All of it is kept in")
    assert max(len(line) for line in tables.splitlines()) <= 80

    rows = re.findall(r"^(P\d/c\d)((?: +-?[\d.]+){6}) *$", tables, re.MULTILINE)
    assert len(rows) == 15
    measurements = {
        f"{m['pose_id']}/c{m['cycle']}": m for m in json.loads((folder / "measurements.json").read_text())
    }
    for name, figures in rows:
        position = measurements[name]["calibration"]["pose"]["position_mm"]
        assert [f"{value:.2f}" for value in position] == figures.split()[:3]
    assert (folder / "overlay-P1.png").exists()
    for kept in re.findall(r"^  ([\w.-]+\.(?:json|png|sqlite3)) ", where, re.MULTILINE):
        assert (folder / kept).exists()

    again = demo(folder, 80)
    assert again.returncode == 2
    assert "is not empty" in again.stdout
