"""The documents' pictures can be drawn from the code as it is."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).parents[2]


def test_the_pictures_of_detection_are_drawn(tmp_path: Path) -> None:
    """Each shows marks in colour on a grey picture, and docs/detection.md shows each."""
    script = ROOT / "docs" / "pictures" / "draw_detection.py"
    done = subprocess.run(
        [sys.executable, str(script), "--seed", "3", "--into", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    text = (ROOT / "docs" / "detection.md").read_text(encoding="utf-8")
    drawn = sorted(tmp_path.glob("*.png"))
    assert [str(path) for path in drawn] == sorted(done.stdout.split())
    assert len(drawn) == 3
    for path in drawn:
        assert f"(pictures/{path.name})" in text
        assert (ROOT / "docs" / "pictures" / path.name).exists()
        picture = cv2.imread(str(path)).astype(int)
        assert np.count_nonzero(np.ptp(picture, axis=2) > 40) > 500, path.name
