"""URDF chains as Denavit-Hartenberg parameters: published arms, drawn arms, and files that hold no such chain."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float

from app.analyses.inputs.session_loader import nominal_chain
from app.client.commands.record_files import FileRefused
from app.client.commands.robots.known import KNOWN, known_robot
from app.client.commands.robots.urdf import UrdfRobot, parse_urdf, read_urdf
from core.geometry import invert, transform
from core.kinematics import Chain
from core.kinematics.dh import forward
from tests.support.simulation.robots.published_arms import AHEAD, LEFT, PUBLISHED, UP, ZERO, by_file, urdf


def chain_of(robot: UrdfRobot) -> Chain:
    found = nominal_chain(robot.joints)
    assert found is not None
    return found


def assert_same_motion(text: str, robot: UrdfRobot, rng: np.random.Generator, within_mm: float) -> None:
    """Check that parameters and file move the flange equally, but for a constant base and tool."""
    base = transform(np.array(robot.T_base_dh.rotation), np.array(robot.T_base_dh.position_mm))
    poses = []
    for _ in range(6):
        q = rng.uniform(-2.5, 2.5, len(robot.joints))
        poses.append((by_file(text, q), base @ forward(chain_of(robot), q[None])[0]))
    tool = invert(poses[0][1]) @ poses[0][0]
    for expected, found in poses:
        np.testing.assert_allclose((found @ tool)[:3, 3], expected[:3, 3], atol=within_mm)
        np.testing.assert_allclose((found @ tool)[:3, :3], expected[:3, :3], atol=within_mm / 100.0)


@pytest.mark.parametrize("model", PUBLISHED)
def test_known_arms_are_what_their_makers_files_say(model: str) -> None:
    text = urdf(*PUBLISHED[model])
    robot, known = parse_urdf(text), known_robot(model)
    assert known is not None
    for joint, row in zip(robot.joints, known.rows, strict=True):
        values = [joint[name] for name in ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg")]
        assert values == pytest.approx(row, abs=1e-6)
        assert (joint["minimum_deg"], joint["maximum_deg"]) == (-171.8873, 114.5916)
    assert robot.deviation_mm < 1e-6
    # Rounded to 1.5708 in the file, angles are taken as what they stand for: 4 µrad over some 2 m.
    assert_same_motion(text, robot, np.random.default_rng(3), 0.05)


@pytest.mark.parametrize("seed", range(6))
def test_any_axes_are_described_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)

    def words(values: Float[np.ndarray, "3"]) -> str:
        return " ".join(repr(float(v)) for v in values)

    joints = [
        (words(rng.uniform(-0.6, 0.6, 3)), words(rng.uniform(-3, 3, 3)), words(rng.normal(0, 1, 3)))
        for _ in range(rng.integers(2, 8))
    ]
    tool = (words(rng.uniform(-0.2, 0.2, 3)), words(rng.uniform(-3, 3, 3)), "")
    robot = parse_urdf(urdf(joints, tool))
    assert robot.deviation_mm < 1e-4
    assert_same_motion(urdf(joints, tool), robot, rng, 1e-3)


def test_axes_that_are_nearly_parallel_have_hayati_s_form() -> None:
    joints = [(ZERO, ZERO, UP), ("0.5 0 0", "0.0003 0.0001 0", UP), ("0.5 0 0.1", ZERO, AHEAD)]
    robot = parse_urdf(urdf(joints))
    first, second = robot.joints[:2]
    assert (first["alpha_deg"], first["beta_deg"]) == pytest.approx(np.degrees([0.0003, 0.0001]), abs=1e-6)
    assert (first["a_mm"], first["d_mm"], second["alpha_deg"]) == pytest.approx((500.0, 0.0, 90.0))
    assert "beta_deg" not in second
    assert_same_motion(urdf(joints), robot, np.random.default_rng(1), 1e-6)


@pytest.mark.parametrize(
    ("written", "is_quarter"),
    [
        ("1.5708", True),
        ("1.570796", True),
        ("-1.57079", True),
        ("1.5707964", True),
        ("1.570802", False),
        ("1.57081", False),
    ],
)
def test_angles_are_exact_where_the_digits_that_are_written_allow_it(written: str, is_quarter: bool) -> None:
    robot = parse_urdf(urdf([(ZERO, ZERO, UP), ("0.5 0 0", f"{written} 0 0", UP)]))
    assert (abs(robot.joints[0]["alpha_deg"]) == 90.0) == is_quarter


def test_the_end_is_the_tool_frame_of_the_longest_chain() -> None:
    text = urdf([(ZERO, ZERO, UP), ("0.1 0 0", ZERO, LEFT)])
    branch = '<joint name="cam" type="fixed"><parent link="l1"/><child link="camera"/></joint>'
    finger = '<joint name="f{0}" type="revolute"><parent link="l2"/><child link="finger{0}"/></joint>'
    assert parse_urdf(text.replace("</robot>", branch + "</robot>")).end == "tool0"
    prefixed = text.replace("tool0", "left_tool0")
    assert parse_urdf(prefixed).end == "left_tool0"
    with pytest.raises(FileRefused, match="several chains of 3"):
        parse_urdf(text.replace("</robot>", finger.format(1) + finger.format(2) + "</robot>"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{}", "not XML"),
        ("<sdf/>", "no URDF"),
        ("<robot/>", "no joint that turns"),
        ("<!DOCTYPE a [<!ENTITY b 'c'>]><robot/>", "entities"),
        (urdf([(ZERO, ZERO, UP)]).replace('"-3.0"', '"${pi}"'), "xacro"),
        (urdf([(ZERO, ZERO, UP)], kind="prismatic"), "is prismatic"),
        (urdf([(ZERO, ZERO, ZERO)]), "no direction"),
        (urdf([("0 0", ZERO, UP)]), "three numbers"),
        (urdf([("0 0 x", ZERO, UP)]), "no number"),
        (urdf([("0 0 nan", ZERO, UP)]), "no number"),
        (urdf([(ZERO, ZERO, UP)]).replace('<parent link="l0"/>', ""), "no parent"),
        (urdf([(ZERO, ZERO, UP)]).replace('"l0"', '"tool0"'), "ring"),
        (urdf([(ZERO, ZERO, UP)]).replace("<limit", '<mimic joint="a"/><limit'), "follows another"),
        (urdf([(ZERO, ZERO, UP)] * 13), "at most 12"),
    ],
)
def test_what_is_no_arm_is_refused(text: str, words: str) -> None:
    with pytest.raises(FileRefused, match=words):
        parse_urdf(text)


@pytest.mark.parametrize("encoding", ["utf-8", "iso-8859-1", "utf-16"])
def test_a_file_is_read_in_its_encoding_and_with_a_namespace(tmp_path: Path, encoding: str) -> None:
    text = (
        urdf([(ZERO, ZERO, UP)]).replace("<robot ", '<robot xmlns="http://www.ros.org" ').replace("l0", "Füß")
    )
    file = tmp_path / "arm.urdf"
    file.write_text(f'<?xml version="1.0" encoding="{encoding}"?>\n{text}', encoding=encoding)
    assert len(read_urdf(file).joints) == 1


def test_every_known_arm_has_a_source_and_a_reach_of_an_arm() -> None:
    for robot in KNOWN:
        assert re.search(r"https://|manual", robot.source), robot
        q = np.zeros((1, len(robot.rows)))
        reach_mm = float(np.linalg.norm(forward(Chain.from_rows(robot.rows), q)[0, :3, 3]))
        assert 300.0 < reach_mm < 3000.0
        assert known_robot(f"{robot.maker} {robot.model}".upper().replace(" ", "-")) is robot
    assert known_robot("arm") is None


def test_a_link_with_two_parents_is_refused_by_the_names_of_its_joints() -> None:
    joints = (("A1", "revolute", "b", "tool0"), ("Z", "fixed", "q", "tool0"))
    text = "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/></joint>'
        for name, kind, parent, child in joints
    )
    with pytest.raises(FileRefused, match="Link tool0 hangs on joints A1 and Z"):
        parse_urdf(f'<robot name="a">{text}</robot>')
