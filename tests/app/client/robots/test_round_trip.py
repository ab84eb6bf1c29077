"""Identified arms as files and back as nominal robots: the same motion, with parameters of the arm's own size."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.analyses.documents.robot_files import WRITERS, Model
from app.analyses.inputs.session_loader import nominal_chain
from app.client.commands.robots.joint_files import read_joints
from app.client.commands.robots.urdf import parse_urdf
from core.geometry import invert, transform
from core.kinematics import Chain, forward

LBR_TWISTS = (-90, 90, 90, -90, -90, 90, 0)
ARMS: dict[str, tuple[tuple[float, float, float, float], ...]] = {
    "KR6": ((180, -90, 400, 0), (600, 0, 0, 0), (120, -90, 0, 0), (0, 90, 620, 0), (0, -90, 0, 0), (0, 0, 115, 0)),
    "UR": ((0, 90, 128, 0), (-612, 0, 0, 0), (-572, 0, 0, 0), (0, 90, 164, 0), (0, -90, 116, 0), (0, 0, 92, 0)),
    "F90": ((150, -90, 450, 0), (590, 0, 0, -90), (130, -90, 0, 0), (0, 90, 647, 0), (0, -90, 0, 0), (0, 0, 95, 0)),
    "SCARA": ((350, 0, 400, 0), (300, 180, 0, 0), (0, 0, 60, 0)),
    "LBR": tuple((0, alpha, d, 0) for alpha, d in zip(LBR_TWISTS, (340, 0, 400, 0, 400, 0, 126), strict=True)),
    "palletiser": ((300, -90, 600, 0), (1050, 0, 0, 0), (1100, 0, 0, 0), (250, -90, 0, 0)),
}  # fmt: skip
WITHIN_MM = 0.01
TILT_DEG, LENGTH_MM, OFFSET_DEG = 0.05, 1.0, 0.1


def identified(name: str, seed: int, tilt_deg: float = TILT_DEG) -> Model:
    """An arm off its data sheet by what workshops leave, β of each nearly parallel pair among it."""
    rng = np.random.default_rng(seed)
    joints: list[dict[str, Any]] = []
    for number, row in enumerate(ARMS[name], 1):
        parallel = number < len(ARMS[name]) and math.sin(math.radians(row[1])) ** 2 < 0.5
        off = rng.normal(size=5) * (LENGTH_MM, tilt_deg, LENGTH_MM * (not parallel), OFFSET_DEG, tilt_deg)
        values = np.array(row) + off[:4]
        keys = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg")
        joint = {"joint": number, **dict(zip(keys, values.tolist(), strict=True))}
        joint |= {
            "beta_deg": float(off[4]) if parallel else None,
            "parallel_to_next": parallel,
            "nominal": None,
        }
        unknown = dict.fromkeys((*keys, "beta_deg"))
        joints.append(
            {**joint, "standard_uncertainty": unknown, "identifiable": dict.fromkeys(unknown, True)}
        )
    document = {
        **{"session_id": "ses_1", "inputs_sha256": "0" * 64, "core_version": "0", "method": "global"},
        **{"source": "measured_poses", "joint_coupling": None, "chain_residual": None, "flange_camera": None},
        **{"residual": {"position_rms_mm": 0.05}, "joints": joints},
    }
    names = tuple(f"joint_{number}" for number in range(1, len(joints) + 1))
    return Model(document, name, names, (None,) * len(joints), False)


def chain(joints: Any) -> Chain:
    """The chain that a robot with these joints has in analyses, or that was identified."""
    found = nominal_chain(joints)
    assert found is not None
    return found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("arm", ARMS)
def test_an_exported_urdf_comes_back_as_the_same_arm(arm: str, seed: int) -> None:
    model = identified(arm, seed)
    robot = parse_urdf(WRITERS["urdf"](model))
    q = np.random.default_rng(seed).uniform(-3.0, 3.0, (100, len(model.joints)))
    expected = forward(chain(model.joints), q)
    base = transform(np.array(robot.T_base_dh.rotation), np.array(robot.T_base_dh.position_mm))
    found = base @ forward(chain(robot.joints), q)
    found = found @ invert(found[0]) @ expected[0]  # the tool is the same for all poses
    assert np.linalg.norm((found - expected)[:, :3, 3], axis=1).max() < WITHIN_MM
    assert np.abs(found - expected)[:, :3, :3].max() < 1e-6
    assert robot.deviation_mm < 1e-3
    # Parameters are those of the data sheet but for what workshops leave; lengths along parallel axes add up.
    for joint, row in zip(robot.joints, ARMS[arm], strict=True):
        assert joint["a_mm"] == pytest.approx(row[0], abs=6 * LENGTH_MM)
        assert abs(math.remainder(joint["alpha_deg"] - row[1], 180.0)) < 0.3
        assert abs(joint["d_mm"]) < abs(row[2]) + 1000.0
        assert abs(joint.get("beta_deg", 0.0)) < 0.3
    stated = [bool(joint.get("beta_deg")) for joint in robot.joints]
    assert stated == [joint["parallel_to_next"] for joint in model.joints]


def test_an_exported_table_comes_back_as_the_same_arm(tmp_path: Path) -> None:
    model = identified("UR", 1)
    path = tmp_path / "arm.csv"
    path.write_text(WRITERS["csv"](model), encoding="utf-8")
    joints = read_joints(path, print)
    np.testing.assert_allclose(chain(joints).as_array(), chain(model.joints).as_array(), atol=1e-15)
    assert [joint.get("beta_deg") for joint in joints] == [joint["beta_deg"] for joint in model.joints]


@pytest.mark.parametrize("tilt_deg", [0.0005, 0.02, 0.5, 2.0])
def test_the_description_is_of_one_form_however_much_axes_are_tilted(tilt_deg: float) -> None:
    model = identified("KR6", 2, tilt_deg)
    robot = parse_urdf(WRITERS["urdf"](model))
    assert abs(robot.joints[1]["d_mm"]) + abs(robot.joints[2]["d_mm"]) < 200.0
    assert robot.deviation_mm < 1e-3
    assert robot.joints[1]["beta_deg"] != 0.0


def test_which_axes_are_nearly_parallel_is_said(tmp_path: Path) -> None:
    path, said = tmp_path / "arm.urdf", list[str]()
    path.write_text(WRITERS["urdf"](identified("UR", 1)), encoding="utf-8")
    read_joints(path, said.append)
    assert "Joints 2, 3" in said[-1]
