"""The poses of a UR10 by a laser tracker, read from the real data (source and layout: test_ur10_identification)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from core.kinematics.pose_observations import PoseData


def tracked(data_folder: Path, series: str = "Series_B") -> PoseData:
    file = data_folder / "ur10_lasertracker" / series / "measurements_joint_configurations.csv"
    lines = file.read_text().splitlines()
    rows = np.array([[float(text.replace(",", ".")) for text in line.split(";")] for line in lines[1:]])
    column = {name: i for i, name in enumerate(lines[0].split(";"))}
    angles = rows[:, [column[f"measurement_r{axis}"] for axis in "xyz"]]
    joints = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    return PoseData(
        rows[:, [column[f"{joint}_joint"] for joint in joints]],
        rows[:, [column[f"measurement_{axis}"] for axis in "xyz"]],
        Rotation.from_euler("XYZ", angles, degrees=True).as_matrix(),
    )
