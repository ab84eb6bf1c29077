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


def test_the_picture_of_frames_is_drawn(tmp_path: Path) -> None:
    script = ROOT / "docs" / "pictures" / "draw_frames.py"
    done = subprocess.run(
        [sys.executable, str(script), "--into", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    (path,) = tmp_path.glob("*.png")
    assert done.stdout.split() == [str(path)]
    assert f"(pictures/{path.name})" in (ROOT / "docs" / "kinematics.md").read_text(encoding="utf-8")
    drawn, kept = (cv2.imread(str(p)).astype(int) for p in (path, ROOT / "docs" / "pictures" / path.name))
    assert drawn.shape == kept.shape
    for k in range(3):  # arrows in blue, green and red
        others = np.delete(drawn, k, axis=2).max(axis=2)
        assert np.count_nonzero(drawn[:, :, k] - others > 60) > 100


def test_the_pictures_of_targets_are_drawn(tmp_path: Path) -> None:
    """One of each kind, as the command line prints it, and the kept ones are these."""
    script = ROOT / "docs" / "pictures" / "draw_targets.py"
    done = subprocess.run(
        [sys.executable, str(script), "--into", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    text = (ROOT / "docs" / "targets.md").read_text(encoding="utf-8")
    drawn = sorted(tmp_path.glob("*.png"))
    assert [str(path) for path in drawn] == sorted(done.stdout.split())
    assert len(drawn) == 6
    for path in drawn:
        assert f"(pictures/{path.name})" in text
        fresh, kept = (cv2.imread(str(p)).astype(int) for p in (path, ROOT / "docs" / "pictures" / path.name))
        assert fresh.shape == kept.shape
        assert np.mean(np.abs(fresh - kept) > 60) < 0.002, path.name
