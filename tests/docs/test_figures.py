"""The documents' figures can be drawn from the code as it is."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

DOCS = Path(__file__).parents[2] / "docs"
FIGURES = DOCS / "figures"


def maker(script: str, name: str) -> Callable[..., Any]:
    """The function of that name in one of the scripts that `make figures` runs."""
    function: Callable[..., Any] = runpy.run_path(str(FIGURES / script))[name]
    return function


def assert_shown(drawn: list[Path], document: str, folder: Path) -> None:
    """These are all files of the folder, a document shows each of them, and they are kept alongside it."""
    assert sorted(folder.iterdir()) == sorted(drawn)
    text = (DOCS / document).read_text(encoding="utf-8")
    for path in drawn:
        assert f"(figures/{path.name})" in text
        assert (FIGURES / path.name).exists()


def assert_as_kept(drawn: list[Path]) -> None:
    for path in drawn:
        fresh, kept = colours(path), colours(FIGURES / path.name)
        assert fresh.shape == kept.shape
        assert np.mean(np.abs(fresh - kept) > 60) < 0.002, path.name


def colours(path: Path) -> np.ndarray:
    return cv2.imread(str(path)).astype(int)


@pytest.mark.slow
def test_the_figures_of_detection_are_drawn(tmp_path: Path) -> None:
    """Each shows marks in colour on a grey image."""
    drawn = maker("draw_detection.py", "draw_all")(3, tmp_path)
    assert len(drawn) == 3
    assert_shown(drawn, "detection.md", tmp_path)
    for path in drawn:
        assert np.count_nonzero(np.ptp(colours(path), axis=2) > 40) > 500, path.name


def test_the_figure_of_frames_is_drawn(tmp_path: Path) -> None:
    path = maker("draw_frames.py", "draw")(tmp_path)
    assert_shown([path], "kinematics.md", tmp_path)
    drawn = colours(path)
    assert drawn.shape == colours(FIGURES / path.name).shape
    for k in range(3):  # arrows in blue, green and red
        others = np.delete(drawn, k, axis=2).max(axis=2)
        assert np.count_nonzero(drawn[:, :, k] - others > 60) > 100


@pytest.mark.slow
def test_the_figures_of_targets_are_drawn(tmp_path: Path) -> None:
    """One of each kind, as the command line prints it, and the kept ones are these."""
    drawn = maker("draw_targets.py", "draw_all")(tmp_path)
    assert len(drawn) == 6
    assert_shown(drawn, "targets.md", tmp_path)
    assert_as_kept(drawn)


def test_the_figures_of_uncertainty_are_drawn(tmp_path: Path) -> None:
    drawn = maker("draw_uncertainty.py", "draw_all")(tmp_path)
    assert len(drawn) == 3
    assert_shown(drawn, "uncertainty.md", tmp_path)
    assert_as_kept(drawn)


@pytest.mark.slow
def test_the_figures_of_estimated_sessions_are_drawn(tmp_path: Path) -> None:
    drawn = maker("draw_statements.py", "draw_all")(tmp_path)
    assert len(drawn) == 4
    assert_shown(drawn, "uncertainty.md", tmp_path)
    for path in drawn:  # estimates move a little with every change of theirs, and axes with them
        fresh, kept = colours(path), colours(FIGURES / path.name)
        assert fresh.shape == kept.shape
        marks = [np.count_nonzero(np.ptp(one, axis=2) > 40) for one in (fresh, kept)]
        assert marks[0] == pytest.approx(marks[1], rel=0.3), path.name
        assert marks[0] > 500, path.name


def test_the_figure_of_the_architecture_shows_every_layer(tmp_path: Path) -> None:
    """The committed figure is drawn from the layers and imports as they are."""
    path = maker("draw_architecture.py", "draw")(tmp_path)
    assert_shown([path], "architecture.md", tmp_path)
    fresh, kept = colours(path), colours(FIGURES / path.name)
    assert fresh.shape == kept.shape
    layers = maker("draw_architecture.py", "layers")
    names = {name for root in ("app", "core") for row in layers(root) for name in row}
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    assert {name for name in names if f"`{name}`" not in text} == set()
