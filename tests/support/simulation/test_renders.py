"""Renders kept on disk are those of the renderer, and another scene's are never taken for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.geometry.camera import Camera
from core.geometry.se3 import so3_exp, transform
from core.simulation import renderer
from core.simulation.scenes import Light, Scene
from core.targets.specification import TargetSpec
from tests.support.simulation import renders

SCENE = Scene(
    TargetSpec("chessboard", 5, 4, 20.0),
    Camera(300.0, 300.0, 79.5, 59.5, k1=-0.1),
    transform(so3_exp(np.array([0.3, -0.2, 0.1])), np.array([-40.0, -30.0, 260.0])),
    160,
    120,
    noise_levels=2.0,
    clutter=1.0,
)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Scene]:
    """The scenes that the renderer itself had to draw, with an empty cache to begin with."""
    drawn: list[Scene] = []

    def counted(draw: Callable[[Scene], np.ndarray]) -> Callable[[Scene], np.ndarray]:
        def render(scene: Scene) -> np.ndarray:
            drawn.append(scene)
            return draw(scene)

        render.__name__ = draw.__name__
        return render

    monkeypatch.setenv("GRIDPOSE_TEST_RENDERS", str(tmp_path / "renders"))
    monkeypatch.setattr(renderer, "render", counted(renderer.render))
    return drawn


def test_a_scene_is_rendered_once(drawn: list[Scene], tmp_path: Path) -> None:
    first = renders.render(SCENE)
    expected = first.copy()
    first[:] = 0  # what a test does with its copy reaches nobody else
    again = renders.render(replace(SCENE, T_camera_target=SCENE.T_camera_target.copy()))
    np.testing.assert_array_equal(again, expected)
    assert len(drawn) == 1
    assert [path.suffix for path in (tmp_path / "renders").iterdir()] == [".npy"]


@pytest.mark.parametrize(
    "changes",
    [
        {"seed": 1},
        {"light": Light(black_level=31.0)},
        {"camera": Camera(300.0, 300.0, 79.5, 59.5, k1=-0.11)},
        {"T_camera_target": SCENE.T_camera_target + np.diag([0.0, 0.0, 1e-12, 0.0])},
        {"target": replace(SCENE.target, columns=6)},
    ],
    ids=str,
)
def test_any_other_scene_is_another_image(drawn: list[Scene], changes: dict[str, object]) -> None:
    renders.render(SCENE)
    renders.render(replace(SCENE, **changes))
    assert len(drawn) == 2


def test_without_a_folder_nothing_is_kept(drawn: list[Scene], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GRIDPOSE_TEST_RENDERS", "")
    for _ in range(2):
        renders.render(SCENE)
    assert len(drawn) == 2


def test_the_longest_unused_are_removed(
    drawn: list[Scene], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(renders, "MAX_BYTES", 3 * (160 * 120 + 128))
    for seed in range(5):
        renders.render(replace(SCENE, seed=seed))
    assert len(list((tmp_path / "renders").iterdir())) == 3
    renders.render(replace(SCENE, seed=4))
    assert len(drawn) == 5
    renders.render(replace(SCENE, seed=0))
    assert len(drawn) == 6
