"""Exported robots read back by other programs' parsers: the same forward kinematics to 1e-9."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from pytransform3d.urdf import UrdfTransformManager
from roboticstoolbox import DHRobot, ERobot

from app.analyses.documents.robot_files import WRITERS, Model, exports_of
from core.geometry.se3 import so3_exp, transform
from core.kinematics.dh import Chain, JointParameters, forward
from core.simulation.arm import KR5_ARC_ROWS

T_FLANGE_CAMERA = transform(so3_exp(np.array([0.1, -0.7, 2.0])), np.array([30.0, -20.0, 90.0]))
NAMES = tuple(f"axis {i} & <co>" for i in range(1, 7))


def joint(number: int, row: tuple[float, ...], beta_deg: float | None) -> dict[str, Any]:
    names = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg")
    return {
        "joint": number,
        **dict(zip(names, row, strict=True)),
        "beta_deg": beta_deg,
        "parallel_to_next": beta_deg is not None,
        "standard_uncertainty": {**dict.fromkeys(names, 0.01), "beta_deg": None},
        "nominal": None if number == 3 else dict(zip(names, row, strict=True)),
        "identifiable": {**dict.fromkeys(names, True), "beta_deg": beta_deg is not None},
        "arc_deg": 80.0,
        "poses": 11,
        "residual": None,
    }


def model(rows: Any = None, beta: float | None = None, **changes: Any) -> Model:
    """A robot near the KR5, every parameter off by something with many digits, joint 2 with β where it is given."""
    rng = np.random.default_rng(5)
    rows = rows or [tuple(float(v) for v in np.array(row) + rng.normal(0.0, 0.7, 4)) for row in KR5_ARC_ROWS]
    joints = [joint(i + 1, row, beta if i == 1 else None) for i, row in enumerate(rows)]
    document = {
        **{"session_id": "ses_1", "inputs_sha256": "0" * 64, "core_version": "0.1.0"},
        **{"method": "global", "source": "measured_poses", "estimator": "pooled", "named_sweeps": []},
        **{
            "convention": "classic_dh",
            "joint_coupling": None,
            "condition_number": 50.0,
            "null_space": [{"parameters": ["joint_1.d_mm"], "sentence": "d1 -- and more."}],
            "model": "auto",
            "error_model": None,
            "level": None,
            "region": {"joints": []},
            "method_agreement": None,
        },
        "joints": joints,
        "residual": {"position_rms_mm": 0.05, "rotation_rms_deg": 0.005},
        "chain_residual": None,
        "validation": None,
        "flange_camera": {"T_flange_camera": T_FLANGE_CAMERA.tolist()},
        "base_targets": [{"target_id": None, "T_base_target": np.eye(4).tolist()}],
        "warnings": [],
    }
    plain = Model(
        document, 'KR5 "Arc" & <co> -- ü', tuple(f"joint_{i}" for i in range(1, 7)), (None,) * 6, True
    )
    return dataclasses.replace(plain, **changes)


def chain(of: Model) -> Chain:
    return Chain(
        tuple(
            JointParameters(
                j["a_mm"],
                math.radians(j["alpha_deg"]),
                j["d_mm"],
                math.radians(j["theta_offset_deg"]),
                math.radians(j["beta_deg"] or 0.0),
            )
            for j in of.joints
        )
    )


def configurations() -> Any:
    return np.random.default_rng(8).uniform(-math.pi, math.pi, (20, 6))


def agree(T_m: Any, T_mm: Any) -> None:
    """The same place to 1e-9 mm... of an arm of 1.5 m, and the same orientation to 1e-9."""
    assert np.abs(1000.0 * T_m[:3, 3] - T_mm[:3, 3]).max() < 1e-9
    assert np.abs(T_m[:3, :3] - T_mm[:3, :3]).max() < 1e-12


@pytest.mark.parametrize("beta", [None, 0.0123456789])
@pytest.mark.parametrize("rows", [None, KR5_ARC_ROWS])
def test_urdf(beta: float | None, rows: Any) -> None:
    """The nominal's right angles put URDF's roll, pitch and yaw at their singularity, where digits are lost easily."""
    of = model(rows, beta, joint_names=NAMES, limits_deg=((-350.0, 350.0),) * 6)
    tree = UrdfTransformManager()
    tree.load_urdf(WRITERS["urdf"](of))
    for q, T in zip(configurations(), forward(chain(of), configurations()), strict=True):
        for name, angle in zip(NAMES, q, strict=True):
            tree.set_joint(name, angle)
        agree(tree.get_transform("flange", "base_link"), T)
        agree(tree.get_transform("camera", "base_link"), T @ T_FLANGE_CAMERA)
    assert tree.get_joint_limits(NAMES[2]) == pytest.approx((-math.radians(350.0), math.radians(350.0)))


def test_a_file_states_the_residual_of_what_it_holds() -> None:
    whole = {"position_rms_mm": 0.08, "rotation_rms_deg": 0.01}
    alone = {"position_rms_mm": 0.65, "rotation_rms_deg": 0.02}
    of = model()
    for residual, said in ((None, "rms residual 0.08 mm"), (alone, "rms residual 0.65 mm")):
        document = {**of.document, "residual": whole, "chain_residual": residual}
        text = WRITERS["urdf"](dataclasses.replace(of, document=document))
        assert said in text
        assert ("does not hold, 0.08 mm" in text) == (residual is not None)


def test_urdf_of_coupled_joints_has_joints_that_mimic() -> None:
    """The toolbox ignores `mimic`, so that the test turns those joints as it says."""
    coupling = np.eye(6)
    coupling[2, 1], coupling[4, 3], coupling[4, 4], coupling[5, 4] = 1.0, -0.01, 0.99, 0.02
    of = model(joint_names=NAMES)
    of.document["joint_coupling"] = coupling.tolist()
    text = WRITERS["urdf"](of)
    tree = UrdfTransformManager()
    tree.load_urdf(text)
    followers = [
        (joint.attrib["name"], joint.find("mimic"))
        for joint in ElementTree.fromstring(text).iter("joint")
        if joint.find("mimic") is not None
    ]
    assert len(followers) == 4
    for stated in configurations():
        angles = dict(zip(NAMES, stated, strict=True))
        for name, angle in angles.items():
            tree.set_joint(name, angle)
        for name, rule in followers:
            tree.set_joint(name, float(rule.attrib["multiplier"]) * angles[rule.attrib["joint"]])
        agree(tree.get_transform("flange", "base_link"), forward(chain(of), (coupling @ stated)[None])[0])


def test_names_of_a_urdf_are_unique_whatever_the_robot_s_joints_are_called() -> None:
    names = ("flange_joint", "camera_joint", "a", "a_of_b", "b_of_c", "c")
    of = model(joint_names=names)
    coupling = np.eye(6)
    coupling[2, 4] = coupling[3, 5] = 1.0  # a by b_of_c, a_of_b by c
    of.document["joint_coupling"] = coupling.tolist()
    robot = ElementTree.fromstring(WRITERS["urdf"](of))
    for kind in ("joint", "link"):
        found = [element.attrib["name"] for element in robot.findall(kind)]
        assert len(set(found)) == len(found) == {"joint": 10, "link": 11}[kind]
    assert {"flange", "camera"} <= {link.attrib["name"] for link in robot.findall("link")}
    tree = UrdfTransformManager()
    tree.load_urdf(WRITERS["urdf"](model(joint_names=("flange", "link_1", "base_link", "camera", "e", "f"))))
    tree.set_joint("flange", 1.0)
    agree(tree.get_transform("flange", "base_link"), forward(chain(of), np.eye(6)[:1])[0])


def test_urdf_without_limits_turns_freely_and_has_a_camera_only_where_asked() -> None:
    text = WRITERS["urdf"](model(with_camera=False))
    assert text.count('type="continuous"') == 6
    assert "limit" not in text
    assert "camera" not in text.replace("from measured poses", "")
    tree = UrdfTransformManager()
    tree.load_urdf(text)
    assert tree.get_joint_limits("joint_1") == (-np.inf, np.inf)
    tree.load_urdf(WRITERS["urdf"](model(limits_deg=(None, (-90.0, 65.0), *(None,) * 4))))
    assert tree.get_joint_limits("joint_1") == (-np.inf, np.inf)
    assert tree.get_joint_limits("joint_2") == pytest.approx(np.radians((-90.0, 65.0)))


@pytest.mark.parametrize("beta", [None, 0.0123456789])
@pytest.mark.parametrize("rows", [None, KR5_ARC_ROWS])
def test_robotics_toolbox(beta: float | None, rows: Any) -> None:
    """Run by the toolbox itself: the file is a program."""
    for limits in ((None,) * 6, ((-155.0, 150.0),) * 6):
        of = model(rows, beta, limits_deg=limits)
        names: dict[str, Any] = {}
        exec(compile(WRITERS["roboticstoolbox"](of), "robot.py", "exec"), names)
        robot = names["robot"]
        assert robot.name == of.name
        assert isinstance(robot, DHRobot if beta is None else ERobot)
        assert robot.n == 6
        for q, T in zip(configurations(), forward(chain(of), configurations()), strict=True):
            agree(np.array(robot.fkine(q)), T)
        if limits[0] is not None:
            assert np.asarray(robot.qlim) == pytest.approx(np.radians([[-155.0] * 6, [150.0] * 6]))


@pytest.mark.parametrize("beta", [None, 0.0123456789])
def test_yaml_and_csv_hold_every_digit(beta: float | None) -> None:
    of = model(beta=beta, joint_names=NAMES)
    document = yaml.safe_load(WRITERS["yaml"](of))
    assert document["robot"] == of.name
    assert document["joints"] == [
        {"name": name, **j, "limits_deg": None} for name, j in zip(NAMES, of.joints, strict=True)
    ]
    assert document["flange_camera"] == of.document["flange_camera"]
    rows = list(csv.DictReader(io.StringIO(WRITERS["csv"](of))))
    assert [row["name"] for row in rows] == list(NAMES)
    read = Chain(
        tuple(
            JointParameters(
                float(row["a_mm"]),
                math.radians(float(row["alpha_deg"])),
                float(row["d_mm"]),
                math.radians(float(row["theta_offset_deg"])),
                math.radians(float(row["beta_deg"] or 0.0)),
            )
            for row in rows
        )
    )
    q = configurations()
    assert np.array_equal(forward(read, q), forward(chain(of), q))
    assert (rows[2]["nominal_a_mm"], rows[1]["nominal_a_mm"]) == ("", str(of.joints[1]["nominal"]["a_mm"]))
    assert rows[0]["u_beta_deg"] == ""


def test_a_report_carries_the_files_that_can_express_the_robot() -> None:
    document = model().document
    robot = {"name": "KR5", "joints": [{"name": "joint_2"}, *[{} for _ in range(5)]]}
    carried = exports_of(document, robot, "Cell 4")
    assert set(carried) == {"robot.yaml", "robot.csv", "robot.urdf"}
    names = [row["name"] for row in csv.DictReader(io.StringIO(carried["robot.csv"]))]
    assert names[:3] == ["joint_2", "joint_2_", "joint_3"]
    coupled = {**document, "joint_coupling": np.eye(6).tolist()}
    assert set(exports_of(coupled, None, "Cell 4")) == {"robot.yaml", "robot.urdf"}
    other = {**document, "joints": [{**joint, "a_mm": 7.0} for joint in document["joints"]]}
    of_chain = exports_of(document, robot, "Cell 4", other)
    assert {row["a_mm"] for row in csv.DictReader(io.StringIO(of_chain["robot.csv"]))} == {"7.0"}
    assert of_chain["robot.urdf"] != carried["robot.urdf"]
    assert of_chain["robot.yaml"] == carried["robot.yaml"]
    terms = {"joint_curves": [], "compliance": []}
    assert set(exports_of({**coupled, "error_model": terms}, None, "Cell 4")) == {
        "robot.yaml",
        "robot.urdf",
        "terms.json",
    }
