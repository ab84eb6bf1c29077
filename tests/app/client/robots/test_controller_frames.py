"""What is said of a robot's base and flange: with it, poses of the controller are poses of the robot's parameters."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float

from app.analyses.inputs.session_loader import nominal_chain
from app.client.commands.robots.joint_files import read_joints
from app.client.commands.robots.known import known_robot
from app.client.commands.rotations import Frame, frame_words, parse_frame
from core.geometry import so3_exp, transform
from core.kinematics import Chain, forward
from tests.support.simulation.robots.published_arms import PUBLISHED, by_file, urdf

WORLD = (
    '<joint name="w" type="fixed"><origin xyz="0 0.1 0.33"/><parent link="l0"/><child link="base"/></joint>'
)
T_ROOT_BASE = transform(np.eye(3), np.array([0.0, 100.0, 330.0]))


def given(option: str, words: str) -> Float[np.ndarray, "4 4"]:
    """The frame that a message gives for an option; where it gives none, no motion."""
    found = re.search(rf"{option} ([-\d.,e]+\d)", words)
    frame = Frame() if found is None else parse_frame(found[1])
    return transform(np.array(frame.rotation), np.array(frame.position_mm))


@pytest.mark.parametrize("in_world", [False, True])
@pytest.mark.parametrize("model", PUBLISHED)
def test_poses_of_the_file_are_those_of_the_parameters_with_the_frames_that_are_said(
    tmp_path: Path, model: str, in_world: bool
) -> None:
    text, path, said = urdf(*PUBLISHED[model]), tmp_path / "arm.urdf", list[str]()
    path.write_text(text.replace("</robot>", f"{WORLD}</robot>") if in_world else text)
    chain = nominal_chain(read_joints(path, said.append))
    assert chain is not None
    T_root_base = T_ROOT_BASE if in_world else np.eye(4)
    for q in np.random.default_rng(1).uniform(-2.0, 2.0, (5, len(chain))):
        of_file = np.linalg.inv(T_root_base) @ by_file(text, q)
        found = (
            np.linalg.inv(given("--base", said[-1])) @ forward(chain, q[None])[0] @ given("--tool", said[-1])
        )
        np.testing.assert_allclose(found[:3, 3], of_file[:3, 3], atol=0.05)
        np.testing.assert_allclose(found[:3, :3], of_file[:3, :3], atol=1e-4)


@pytest.mark.parametrize(
    ("model", "x_mm", "z_mm"),
    [  # at zero, by the maker's drawings: lengths ahead of the first axis, and above the controller's base
        ("KR 5 arc", 180.0 + 600.0 + 620.0 + 115.0, 400.0 + 120.0),
        ("KR 10 R1100 sixx", 25.0 + 560.0 + 515.0 + 80.0, 400.0 + 35.0),
        ("IRB 120-3/0.58", 302.0 + 72.0, 290.0 + 270.0 + 70.0),
        ("LR Mate 200iD", 50.0 + 335.0 + 80.0, 330.0 + 35.0),
        ("M-10iA", 150.0 + 640.0 + 100.0, 600.0 + 200.0),
    ],
)
def test_a_known_arm_is_where_its_controller_says(model: str, x_mm: float, z_mm: float) -> None:
    robot = known_robot(model)
    assert robot is not None
    flange = forward(Chain.from_rows(robot.rows), np.zeros((1, 6)))[0]
    of_controller = np.linalg.inv(given("--base", f"--base {robot.base}")) @ flange
    np.testing.assert_allclose(of_controller[:3, 3], [x_mm, 0.0, z_mm], atol=1e-9)


def test_a_frame_in_words_is_read_as_the_same() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        R, t = so3_exp(rng.normal(size=3)), rng.uniform(-900.0, 900.0, 3)
        words = frame_words(Frame(R.tolist(), t.tolist()))
        assert words is not None
        np.testing.assert_allclose(given("--base", f"--base {words}"), transform(R, t), atol=1e-4)
    assert frame_words(Frame()) is None
