"""Robot poses that belong to the photographs of Jmeyer1292/robot_cal_tools (Apache-2.0)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import yaml

from core.geometry.se3 import so3_exp, transform


def tool_pose(file: Path) -> np.ndarray:
    """T_base_flange, mm, from a position in metres and a quaternion."""
    given = yaml.safe_load(file.read_text())
    axis, w = np.array([given["qx"], given["qy"], given["qz"]]), given["qw"]
    angle = 2.0 * math.atan2(float(np.linalg.norm(axis)), w)
    rotation = so3_exp(axis / np.linalg.norm(axis) * angle)
    return transform(rotation, 1000.0 * np.array([given["x"], given["y"], given["z"]]))
