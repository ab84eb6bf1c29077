"""Arms whose makers' files are public, as URDF, and where such a file has the flange."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from core.geometry import so3_exp, transform

Joint = tuple[str, str, str]
"""Origin in m, roll pitch yaw in rad, axis."""
ZERO = "0 0 0"
QUARTER = "1.570796327"
UP, AHEAD, BACK, LEFT, RIGHT = "0 0 1", "1 0 0", "-1 0 0", "0 1 0", "0 -1 0"

PUBLISHED: dict[str, tuple[Sequence[Joint], Joint]] = {
    # UniversalRobots/Universal_Robots_ROS2_Description config/ur30/default_kinematics.yaml
    "UR30": (
        [
            ("0 0 0.2363", ZERO, UP),
            (ZERO, f"{QUARTER} 0 0", UP),
            ("-0.637 0 0", ZERO, UP),
            ("-0.5037 0 0.201", ZERO, UP),
            ("0 -0.1593 0", f"{QUARTER} 0 0", UP),
            ("0 0.1543 -3.16e-11", f"{QUARTER} 3.1415926535897931 3.1415926535897931", UP),
        ],
        (ZERO, ZERO, ""),
    ),
    # ros-industrial/kuka_experimental kuka_kr5_support/urdf/kr5_arc_macro.xacro
    "KR 5 arc": (
        [
            ("0 0 0.4", "3.14159 0 0", UP),
            ("0.18 0 0", "1.5708 0 0", UP),
            ("0.6 0 0", ZERO, UP),
            ("0.62 -0.12 0", "0 -1.5708 0", UP),
            (ZERO, "0 1.5708 0", UP),
            (ZERO, "0 -1.5708 0", UP),
        ],
        ("0 0 -0.115", "0 -3.14159 0", ""),
    ),
    # the same, kuka_kr10_support/urdf/kr10r1100sixx_macro.xacro
    "KR 10 R1100 sixx": (
        [
            ("0 0 0.400", ZERO, "0 0 -1"),
            ("0.025 0 0", ZERO, LEFT),
            ("0.560 0 0", ZERO, LEFT),
            ("0 0 0.035", ZERO, BACK),
            ("0.515 0 0", ZERO, LEFT),
            ("0.080 0 0", ZERO, BACK),
        ],
        (ZERO, "0 1.5708 0", ""),
    ),
    # ros-industrial/abb abb_irb120_support/urdf/irb120_3_58_macro.xacro
    "IRB 120-3/0.58": (
        [
            (ZERO, ZERO, UP),
            ("0 0 0.29", ZERO, LEFT),
            ("0 0 0.27", ZERO, LEFT),
            ("0 0 0.07", ZERO, AHEAD),
            ("0.302 0 0", ZERO, LEFT),
            ("0.072 0 0", ZERO, AHEAD),
        ],
        (ZERO, "0 1.5708 0", ""),
    ),
    # ros-industrial/fanuc fanuc_lrmate200id_support/urdf/lrmate200id_macro.xacro
    "LR Mate 200iD": (
        [
            ("0 0 0.330", ZERO, UP),
            ("0.050 0 0", ZERO, LEFT),
            ("0 0 0.330", ZERO, RIGHT),
            ("0 0 0.035", ZERO, BACK),
            ("0.335 0 0", ZERO, RIGHT),
            ("0.080 0 0", ZERO, BACK),
        ],
        (ZERO, "3.1416 -1.5708 0", ""),
    ),
    # the same, fanuc_m10ia_support/urdf/m10ia_macro.xacro
    "M-10iA": (
        [
            (ZERO, ZERO, UP),
            ("0.15 -0.04 0.45", ZERO, LEFT),
            ("0 -0.0225 0.6", ZERO, RIGHT),
            ("0.1805 0.0625 0.2", ZERO, BACK),
            ("0.4595 -0.0565 0", ZERO, RIGHT),
            ("0.1 0.0565 0", ZERO, BACK),
        ],
        (ZERO, ZERO, ""),
    ),
}


def urdf(joints: Sequence[Joint], tool: Joint = (ZERO, ZERO, ""), kind: str = "revolute") -> str:
    """Return a URDF of the joints, with a link `tool0` at the end."""
    lines = [
        f'<joint name="j{i}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/><parent link="l{i - 1}"/>'
        f'<child link="l{i}"/><axis xyz="{axis}"/><limit lower="-3.0" upper="2.0"/></joint>'
        for i, (xyz, rpy, axis) in enumerate(joints, 1)
    ]
    end = f'<origin xyz="{tool[0]}" rpy="{tool[1]}"/><parent link="l{len(joints)}"/><child link="tool0"/>'
    return f'<robot name="arm">{"".join(lines)}<joint name="end" type="fixed">{end}</joint></robot>'


def numbers(text: str) -> Float[np.ndarray, "3"]:
    return np.array([float(part) for part in text.split()])


def by_file(text: str, joint_angles: Float[np.ndarray, " j"]) -> Float[np.ndarray, "4 4"]:
    """Return the flange's pose (mm) as the URDF has it: an implementation of its own."""
    T, left = np.eye(4), list(joint_angles)
    for joint in ElementTree.fromstring(text).findall("joint"):
        origin, axis = joint.find("origin"), joint.find("axis")
        assert origin is not None
        roll, pitch, yaw = numbers(origin.get("rpy", ""))
        R = (
            so3_exp(np.array([0, 0, yaw]))
            @ so3_exp(np.array([0, pitch, 0]))
            @ so3_exp(np.array([roll, 0, 0]))
        )
        T = T @ transform(R, 1000.0 * numbers(origin.get("xyz", "")))
        if axis is not None:
            direction = numbers(axis.get("xyz", ""))
            T = T @ transform(so3_exp(left.pop(0) * direction / np.linalg.norm(direction)), np.zeros(3))
    return T
