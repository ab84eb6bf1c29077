"""`gridpose robots export` from a real service: files that other programs read, refusals that say what to do."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pytransform3d.urdf import UrdfTransformManager

from app.cli.demo.service_process import ServiceProcess
from app.cli.demo.session import joint_rows
from app.client import ServiceClient
from core.kinematics.dh import Chain, forward
from tests.support.command_line import run_here_at
from tests.support.service.service import TARGET, run_at

TWO_AXES = Chain.from_rows([(150.0, 90.0, 300.0, 10.0), (80.0, 0.0, 20.0, 0.0)])


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """One service for all tests here, which only read its session "cell"."""
    folder = tmp_path_factory.mktemp("export") / "data"
    with ServiceProcess(folder, {"GRIDPOSE_WORKERS": "0"}) as process:
        make_session(process)
        yield process


def make_session(service: ServiceProcess) -> None:
    """A session named "cell" with exact poses of a positioner with two axes."""
    angles = np.radians([[a, b] for a in (-40, 0, 40) for b in (-60, 0, 60)])
    with ServiceClient(service.url, service.admin_key) as client:
        target_id = client.create("/v1/targets", TARGET)["id"]
        joints = [
            {**row, "a_mm": row["a_mm"] + 1.0, "alpha_deg": row["alpha_deg"] + 0.1}
            for row in joint_rows(TWO_AXES)
        ]
        joints[0] |= {"name": "lean", "minimum_deg": -100.0, "maximum_deg": 95.0}
        robot_id = client.create("/v1/robots", {"name": "Positioner", "joints": joints})["id"]
        session = client.create(
            "/v1/sessions", {"name": "cell", "target_ids": [target_id], "robot_id": robot_id}
        )
        client.put_measured_poses(
            session["id"],
            [
                {
                    "pose_id": f"P{i}",
                    "joint_angles_deg": np.degrees(q).tolist(),
                    "position_mm": T[:3, 3].tolist(),
                    "rotation": T[:3, :3].tolist(),
                }
                for i, (q, T) in enumerate(zip(angles, forward(TWO_AXES, angles), strict=True))
            ],
        )


def test_a_robot_comes_out_as_every_file(service: ServiceProcess, tmp_path: Path) -> None:
    export = ("robots", "export", "--session", "cell", "--source", "measured_poses")
    urdf = tmp_path / "robot.urdf"
    options = ("--joint-names", "tilt,turn", "--joint-limits", "-90:90,180", "-o", str(urdf))
    code, said, errors = run_at(service, *export, "--format", "urdf", *options)
    assert (code, said) == (0, ""), errors
    code, text, errors = run_at(service, *export, "--format", "csv")
    assert code == 0, errors
    rows = list(csv.DictReader(io.StringIO(text)))
    assert float(rows[0]["a_mm"]) == pytest.approx(150.0, abs=1e-6)
    found = Chain.from_rows(
        [
            (float(r["a_mm"]), float(r["alpha_deg"]), float(r["d_mm"]), float(r["theta_offset_deg"]))
            for r in rows
        ]
    )
    tree = UrdfTransformManager()
    tree.load_urdf(urdf.read_text(encoding="utf-8"))
    assert tree.get_joint_limits("turn") == (-math.pi, math.pi)
    q = np.radians([[25.0, -130.0]])
    for name, angle in zip(("tilt", "turn"), q[0], strict=True):
        tree.set_joint(name, angle)
    T = tree.get_transform("flange", "base_link")
    T[:3, 3] *= 1000.0
    assert np.abs(T - forward(found, q)[0]).max() < 1e-9
    named = ("--sweep", "1:P0,P3,P6", "--sweep", "1:P1,P4,P7", "--sweep", "2:P?", "--method", "combined")
    code, text, _ = run_here_at(service, *export, "--format", "yaml", *named)
    assert (code, text) == (1, "")  # all nine poses are no sweep of joint 2
    code, text, errors = run_here_at(service, *export, "--format", "yaml", *named[:4], *named[6:])
    assert code == 0, errors
    document = yaml.safe_load(text)
    assert document["named_sweeps"] == ["1:P0,P3,P6", "1:P1,P4,P7"]
    code, text, errors = run_here_at(service, *export, "--format", "yaml")
    assert code == 0, errors
    document = yaml.safe_load(text)
    assert document["robot"] == "Positioner"
    assert document["joints"][0]["a_mm"] == float(rows[0]["a_mm"])
    assert [(j["name"], j["limits_deg"]) for j in document["joints"]] == [
        ("lean", [-100.0, 95.0]),
        ("joint_2", None),
    ]
    code, text, errors = run_here_at(service, *export, "--format", "roboticstoolbox")
    assert code == 0, errors
    program: dict[str, Any] = {}
    exec(compile(text, "robot.py", "exec"), program)
    T = np.array(program["robot"].fkine(q[0]))
    T[:3, 3] *= 1000.0
    assert np.abs(T - forward(found, q)[0]).max() < 1e-9
    assert np.degrees(program["robot"].links[0].qlim) == pytest.approx([-100.0, 95.0])
    code, text, errors = run_here_at(service, *export, "--format", "urdf")
    assert code == 0, errors
    tree = UrdfTransformManager()
    tree.load_urdf(text)
    assert tree.get_joint_limits("lean") == pytest.approx(np.radians([-100.0, 95.0]))
    assert tree.get_joint_limits("joint_2") == (-math.inf, math.inf)


def test_refusals_say_what_to_do(service: ServiceProcess) -> None:
    export = ("robots", "export", "--format", "csv", "--session")
    code, _, said = run_here_at(service, *export, "cell")
    assert code == 1
    assert "too_few_measurements" in said
    code, _, said = run_here_at(service, *export, "nobody")
    assert code == 1
    assert "session_not_found" in said
    measured = ("cell", "--source", "measured_poses")
    for options in (
        ("--joint-names", "a,b,c"),
        ("--joint-limits", "90"),
        ("--joint-limits", "90,x"),
        ("--joint-limits", "90,5:1"),
    ):
        code, text, said = run_here_at(service, *export, *measured, *options)
        assert (code, text) == (2, ""), said
        assert options[0] in said, "the option is named"


def test_coupled_joints_are_written_as_yaml_and_urdf_alone(service: ServiceProcess) -> None:
    export = ("robots", "export", "--session", "cell", "--source", "measured_poses", "--format")
    with ServiceClient(service.url, service.admin_key) as client:
        (robot,) = client.items("/v1/robots")
        address = f"/v1/robots/{robot['id']}"
        client.change(address, {"joint_coupling": [[1.0, 0.0], [0.001, 1.0]]})
        for name in ("roboticstoolbox", "csv"):
            code, text, said = run_here_at(service, *export, name)
            assert (code, text) == (2, "")
            assert "--format yaml" in said
        code, text, errors = run_here_at(service, *export, "yaml")
        assert code == 0, errors
        assert yaml.safe_load(text)["joint_coupling"] == [[1.0, 0.0], [0.001, 1.0]]
        code, text, errors = run_here_at(service, *export, "urdf")
        assert code == 0, errors
        assert text.count("<mimic ") == 1
        # Ones alone couple nothing.
        assert client.change(address, {"joint_coupling": [[1.0, 0.0], [0.0, 1.0]]})["joint_coupling"] is None
    assert run_here_at(service, *export, "csv")[0] == 0


def test_a_plan_is_shown(service: ServiceProcess, tmp_path: Path) -> None:
    with ServiceClient(service.url, service.admin_key) as client:
        (target,) = client.items("/v1/targets")
    plan = {
        "target_id": target["id"],
        "camera": {
            **{"fx_px": 1200.0, "fy_px": 1200.0, "cx_px": 640.0, "cy_px": 480.0},
            **{"image_width_px": 1280, "image_height_px": 960},
        },
        "home_deg": [0.0, 0.0],
        "sweeps": {"sweep_half_angle_deg": 10.0, "steps": 5},
        "suggest_count": 2,
        "image_coverage": 0.3,
    }
    path = tmp_path / "plan.yaml"
    path.write_text(yaml.safe_dump(plan), encoding="utf-8")
    code, shown, errors = run_here_at(service, "robots", "plan", "dh", str(path), "--robot", "Positioner")
    assert code == 0, errors
    assert "10 of 10 poses" in shown
    assert "2 further poses" in shown
    code, _, said = run_here_at(service, "robots", "plan", "dh", str(path), "--robot", "nobody")
    assert (code, "robot_not_found" in said) == (1, True)
    path.write_text("- 1\n", encoding="utf-8")
    code, _, said = run_here_at(service, "robots", "plan", "dh", str(path), "--robot", "Positioner")
    assert (code, path.name in said) == (2, True)
