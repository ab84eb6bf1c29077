"""`gridpose measured-poses import` against a real service: files as documented, sent twice, refused by their lines."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.cli.demo.service_process import ServiceProcess
from app.client import ClientError, ServiceClient
from tests.support.command_line import run_here_at
from tests.support.service.service import run_at

DOCUMENT = Path(__file__).parents[3] / "docs" / "kinematics.md"


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """One service for all tests here, each with a session of its own."""
    with ServiceProcess(tmp_path_factory.mktemp("import") / "data", {"GRIDPOSE_WORKERS": "0"}) as process:
        yield process


def documented(file_name: str, folder: Path) -> list[str]:
    """The command of docs/kinematics.md that imports this file, with the file's real place."""
    blocks = re.findall(r"```sh\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    (command,) = (
        block for block in blocks if file_name in block and "gridpose measured-poses import" in block
    )
    words = shlex.split(command.replace("\\\n", " "))
    assert words[:3] == ["gridpose", "measured-poses", "import"]
    return [str(folder / word) if word.endswith(file_name) else word for word in words[1:]]


def stored(service: ServiceProcess, session: str) -> list[dict[str, Any]]:
    with ServiceClient(service.url, service.admin_key) as client:
        return list(client.items(f"/v1/sessions/{session}/measured-poses"))


def test_a_laser_tracker_s_file_comes_in_as_documented(service: ServiceProcess, data_folder: Path) -> None:
    name = "measurements_joint_configurations.csv"
    command = documented(name, data_folder / "ur10_lasertracker" / "Series_B")
    code, session, said = run_at(service, *command)
    assert code == 0, said
    readings = stored(service, session)
    assert len(readings) == 1495
    assert np.allclose(readings[0]["position_mm"], [383.76294, -3240.8734, 201.93157])
    assert np.allclose(readings[0]["joint_angles_deg"], np.degrees([-3.14159, -1.5708, 0, -1.5708, 0, 0]))
    assert np.sqrt(readings[0]["covariance"][0][0]) == pytest.approx(0.031674)
    R = np.array(readings[0]["rotation"])
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-12)
    # Again: nothing new.
    code, again, said = run_here_at(service, *command)
    assert (code, again) == (0, session)
    assert len(stored(service, session)) == 1495


def test_a_positioner_s_yaml_comes_in_as_documented(service: ServiceProcess, data_folder: Path) -> None:
    command = documented("positioner_kinematic_measurements.yaml", data_folder / "robot_cal_tools")
    code, session, said = run_here_at(service, *command)
    assert code == 0, said
    readings = stored(service, session)
    assert len(readings) == 205
    assert readings[0]["pose_id"] == "1593701755"
    assert np.allclose(readings[0]["position_mm"], [-532.5496958762886, -771.2137113402057, 935.626211340206])
    assert np.allclose(
        readings[0]["joint_angles_deg"], np.degrees([-0.5229825973510742, 0.0002200359886046499])
    )


def test_refusals_name_lines_and_send_nothing(service: ServiceProcess, tmp_path: Path) -> None:
    path = tmp_path / "readings.csv"
    text = "pose,cycle,x,y,z\nP1,1,0,0,0\nP1,2,0,0,zero\nP1,3,0,0,1\n"
    path.write_text(text, encoding="utf-8")
    options = ("measured-poses", "import", str(path), "--session", "s", "--target", "chessboard:9x6:25")
    code, _, said = run_here_at(service, *options)
    assert code == 1
    assert "line 3: z" in said
    code, session, said = run_here_at(service, *options, "--skip-invalid")
    assert code == 0, said
    assert [reading["cycle"] for reading in stored(service, session)] == [1, 3]
    # What the service refuses comes back with the file's lines too.
    path.write_text(text.replace("zero", "2").replace("P1,3,0,0,1", "P1,3,0,0,9"), encoding="utf-8")
    code, _, said = run_here_at(service, *options)
    assert code == 1
    assert "measured_pose_conflict" in said
    assert "line 4: cycle" in said
    assert len(stored(service, session)) == 2


def test_readings_get_joint_angles_by_their_commanded_poses(service: ServiceProcess, tmp_path: Path) -> None:
    path, angles = tmp_path / "readings.csv", tmp_path / "angles.csv"
    rows = [(f"P{k}", 900 + 10 * k, 30 * k, 400 - 5 * k, 3 * k, -4 * k) for k in range(1, 13)]
    path.write_text("pose_id,x_mm,y_mm,z_mm\n" + "".join(f"{p},{x},{y},{z}\n" for p, x, y, z, *_ in rows))
    options = ("measured-poses", "import", str(path), "--session", "angles", "--target", "chessboard:9x6:25")
    code, session, said = run_here_at(service, *options)
    assert code == 0, said

    def refused() -> dict[str, Any]:
        with ServiceClient(service.url, service.admin_key) as client, pytest.raises(ClientError) as error:
            client.get(f"/v1/sessions/{session}/dh", source="measured_poses")
        return {"code": error.value.code, "advice": error.value.advice}

    missing = refused()
    assert missing["code"] == "joint_angles_missing"
    assert "gridpose poses load" in missing["advice"]
    # The same readings with joint angles would count twice: nothing is sent.
    whole = "pose_id,x_mm,y_mm,z_mm,j1_deg,j2_deg\n" + "".join(",".join(map(str, row)) + "\n" for row in rows)
    path.write_text(whole)
    code, _, said = run_here_at(service, *options)
    assert code == 2
    assert "gridpose measured-poses delete" in said
    assert len(stored(service, session)) == 12
    # What the advice says works: angles as commanded poses, or deletion first.
    angles.write_text("pose_id,j1_deg,j2_deg\n" + "".join(f"{p},{a},{b}\n" for p, _, _, _, a, b in rows))
    code, _, said = run_here_at(service, "poses", "load", str(angles), "--session", session)
    assert code == 0, said
    assert refused()["code"] != "joint_angles_missing"
    assert run_here_at(service, "measured-poses", "delete", session, "--all")[0] == 0
    assert run_here_at(service, *options)[0] == 0
    readings = stored(service, session)
    assert len(readings) == 12
    assert readings[0]["joint_angles_deg"] == [3.0, -4.0]
