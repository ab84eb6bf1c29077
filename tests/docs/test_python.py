"""The code of docs/python.md does what the page says, on a small rendered session."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from core.geometry.camera import Camera
from core.geometry.se3 import invert, so3_exp, transform
from core.kinematics.dh import forward
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, Arm, free_angles, kr5_arc
from core.simulation.renderer import render
from core.simulation.scenes import Scene
from core.targets.specification import TargetSpec

PAGE = Path(__file__).parent.parent.parent / "docs" / "python.md"
BOARD = TargetSpec("chessboard", 9, 6, 25.0)
CAMERA = Camera(520.0, 520.0, 319.5, 239.5, -0.05)
TILTS = ((0.5, 0.0), (-0.4, 0.3), (0.1, -0.5), (-0.2, -0.4))
SCATTER_MM = 0.5


def blocks() -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four poses, three visits each, and one image that shows no board."""
    root = tmp_path_factory.mktemp("session")
    rng = np.random.default_rng(9283)
    middle = BOARD.points_target().mean(axis=0)
    for number, (about_x, about_y) in enumerate(TILTS, 1):
        (root / "images" / f"P{number}").mkdir(parents=True)
        R = so3_exp(np.array([about_x, about_y, 0.1 * number]))
        for cycle in (1, 2, 3):
            offset = np.array([0.0, 0.0, 420.0]) + rng.normal(0.0, SCATTER_MM, 3)
            scene = Scene(
                BOARD,
                CAMERA,
                transform(R, offset - R @ middle),
                640,
                480,
                noise_levels=1.0,
                seed=10 * number + cycle,
            )
            cv2.imwrite(str(root / "images" / f"P{number}" / f"{cycle}.png"), render(scene))
    cv2.imwrite(str(root / "images" / "P4" / "4.png"), np.full((480, 640), 128, dtype=np.uint8))
    return root


def test_the_page_s_code_makes_the_table(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    first, second, third, _ = blocks()
    assert sum(bool(line.strip()) for line in first.splitlines()) <= 12
    names: dict[str, Any] = {}
    exec(compile(first, str(PAGE), "exec"), names)
    printed = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in printed] == ["P1", "P2", "P3", "P4"]
    for row in names["table"].poses:
        assert len(row.visits) == 3
        # Of three visits RP is known to a factor of some three; the true one is mean + 3 deviations of |d|.
        assert 0.1 * SCATTER_MM < row.figures.repeatability.position_mm < 10.0 * SCATTER_MM
        low, high = row.figures.interval.position_mm
        assert low < row.figures.repeatability.position_mm < high
        assert 0.0 < row.figures.noise_floor.position_mm < row.figures.repeatability.position_mm
    exec(compile(second, str(PAGE), "exec"), names)
    printed = capsys.readouterr().out.splitlines()
    group = names["group"]
    deviation = math.sqrt(group.estimate.camera_covariance[0, 0])
    assert abs(group.estimate.camera.fx_px - CAMERA.fx_px) < 4.0 * deviation
    assert deviation < 0.02 * CAMERA.fx_px
    assert printed[-1].split()[:2] == [str(Path("images/P4/4.png")), "target_not_found"]
    exec(compile(third, str(PAGE), "exec"), names)
    assert capsys.readouterr().out.startswith("before a print on paper")
    assert names["group"].estimate.camera_covariance[0, 0] > deviation**2


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Images from the flange of an arm that is not built as its nominal, at free poses before one board."""
    root = tmp_path_factory.mktemp("robot")
    (root / "robot").mkdir()
    rng = np.random.default_rng(6)
    arm = kr5_arc(rng)
    at_home = forward(arm.chain, KR5_ARC_HOME[None])[0] @ arm.T_flange_camera
    middle = BOARD.points_target().mean(axis=0)
    R = so3_exp(np.array([0.35, 0.2, 0.1]))
    T_camera_target = transform(R, np.array([0.0, 0.0, 600.0]) - R @ middle)
    arm = Arm(arm.chain, (invert(T_camera_target) @ invert(at_home))[None], arm.T_flange_camera)
    drawn = free_angles(rng, KR5_ARC_HOME, 600, half_range=math.radians(12.0))
    angles, scenes = [], []
    for q, T in zip(drawn, arm.camera_poses(drawn, np.zeros(len(drawn), dtype=np.intp)), strict=True):
        scene = Scene(BOARD, CAMERA, invert(T), 640, 480, noise_levels=1.0, seed=len(angles))
        if scene.points_px.min() > 40.0 and np.all(scene.points_px.max(axis=0) < [600.0, 440.0]):
            angles.append(q)
            scenes.append(scene)
    assert len(angles) >= 24
    for i, scene in enumerate(scenes[:24]):
        cv2.imwrite(str(root / "robot" / f"Q{i}.png"), render(scene))
    lines = [",".join([f"Q{i}", *map(repr, np.degrees(q).tolist())]) for i, q in enumerate(angles[:24])]
    (root / "robot" / "angles.csv").write_text("\n".join(lines) + "\n")
    nominal = [
        (j.a_mm, math.degrees(j.alpha_rad), j.d_mm, math.degrees(j.theta_offset_rad)) for j in KR5_ARC.joints
    ]
    (root / "robot" / "nominal.csv").write_text("\n".join(",".join(map(repr, row)) for row in nominal) + "\n")
    return root


def test_the_page_s_code_identifies_a_robot(
    robot: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(robot)
    first, _, _, fourth = blocks()
    imports = "\n".join(line for line in first.splitlines() if line.startswith(("from", "board")))
    names: dict[str, Any] = {}
    exec(compile(f"{imports}\n{fourth}", str(PAGE), "exec"), names)
    assert len(capsys.readouterr().out.splitlines()) == 6
    found = names["robot"]
    assert found.validation.held_out == 24
    assert found.validation.identified.position_rms_mm < 0.5 * found.validation.nominal.position_rms_mm
    assert found.residual.position_rms_mm < 1.0
