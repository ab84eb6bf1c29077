"""`gridpose robots compensate` against a real server: a robot program in, the same program with other points out."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.geometry import rotation_to_rpy
from core.kinematics import forward
from core.simulation.arm import KR5_ARC
from tests.support.service.service import ApiMaker, environment_of, gridpose
from tests.support.sessions.kinematics import make_robot, readings
from tests.support.sessions.stored_sessions import new_session
from tests.support.sessions.tracked_robot import send
from tests.support.simulation.robots.real_arms import RealArm, angles_within_limits, measured, real_arm

TOOL_MM = 120.0
FAR = "A1 0.00000,A2 -80.00000,A3 80.00000,A4 0.00000,A5 128.00000,A6 0.00000"


def program(q: np.ndarray) -> str:
    """Return a KUKA's points: each as joint angles, and the first ten as those of a tool along the flange's z."""
    lines = ["DEFDAT PART PUBLIC", f"DECL E6AXIS XFAR={{{FAR},E1 0.0}}"]
    for i, angles in enumerate(np.degrees(q)):
        axes = ",".join(f"A{k + 1} {angle:.7f}" for k, angle in enumerate(angles))
        lines.append(f"DECL E6AXIS XJ{i}={{{axes},E1 0.0}}")
    for i, T in enumerate(forward(KR5_ARC, q[:10])):
        x, y, z = T[:3, 3] + TOOL_MM * T[:3, 2]
        roll, pitch, yaw = np.degrees(rotation_to_rpy(T[:3, :3]))
        lines.append(
            f"DECL E6POS XC{i}={{X {x:.5f},Y {y:.5f},Z {z:.5f},A {yaw:.6f},B {pitch:.6f},C {roll:.6f},S 2,T 35}}"
        )
    return "\r\n".join([*lines, "DECL AXIS XPART={A1 5.0}", "ENDDAT", ""])


def joints(text: str) -> np.ndarray:
    found = re.findall(r"XJ\d+=\{A1 (\S+),A2 (\S+),A3 (\S+),A4 (\S+),A5 (\S+),A6 ([^,]+),", text)
    return np.radians(np.array(found, dtype=np.float64))


def positions(text: str) -> np.ndarray:
    return np.array(re.findall(r"XC\d+=\{X (\S+),Y (\S+),Z ([^,]+),", text), dtype=np.float64)


def tips(real: RealArm, q: np.ndarray) -> np.ndarray:
    """Return where an arm's flange is at stated angles."""
    return np.asarray(forward(real.arm.chain, real.turned(q))[:, :3, 3])


def differences(points: np.ndarray, meant: np.ndarray) -> float:
    """Return the rms distance after the best rigid motion: a correction takes out what no base and tool does."""
    a, b = points - points.mean(axis=0), meant - meant.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return float(np.sqrt(np.mean(np.sum((a @ turn - b) ** 2, axis=1))))


@pytest.mark.slow
def test_a_program_goes_in_and_comes_out_with_points_nearer_to_what_they_mean(
    serve_api: ApiMaker, tmp_path: Path
) -> None:
    rng = np.random.default_rng(3)
    real = real_arm(rng)
    q = angles_within_limits(np.random.default_rng(4), 60, share=0.4)
    q[:, 4] = np.radians(np.random.default_rng(5).uniform(20.0, 50.0, len(q)))  # no singular wrist
    source, target = tmp_path / "part.dat", tmp_path / "corrected.dat"
    source.write_bytes(program(q).encode())
    with serve_api() as api:
        robot = make_robot(api)
        session = new_session(api, robot_id=robot)
        send(api, session, readings(measured(real, angles_within_limits(rng, 70), rng)))
        given = ["robots", "compensate", str(source), "--robot", robot, "--session", session]
        given += ["--source", "measured_poses", "--tool", f"0,0,{TOOL_MM:g},0,0,0"]
        environment = environment_of(api)
        done = gridpose(*given, "-o", str(target), **environment)
        assert done.returncode == 0, done.stderr
        assert "left as they are: line 73." in done.stderr
        before, after = source.read_bytes().decode(), target.read_bytes().decode()
        table = gridpose(*given, "-o", str(tmp_path / "table.csv"), **environment)
        assert table.returncode == 0, table.stderr
        refused = gridpose(*given[:-1], "0,0,120", **environment)
        assert (refused.returncode, "no frame" in refused.stderr) == (2, True)
    numbers = r"(?<=[ ])-?\d+\.\d+"
    assert re.sub(numbers, "#", after) == re.sub(numbers, "#", before)
    assert f"XFAR={{{FAR},E1 0.0}}" in after
    # Joint angles: the true arm at the corrected ones is where the nominal arm is at those that were meant.
    meant = forward(KR5_ARC, q)[:, :3, 3]
    assert differences(tips(real, joints(after)), meant) < 0.6 * differences(tips(real, q), meant)
    # The same poses as those of the tool: where it is on the flange of the table.
    with (tmp_path / "table.csv").open(newline="") as table_file:
        rows = list(csv.DictReader(table_file))
    flange = [[float(r[n]) for n in ("x_mm", "y_mm", "z_mm")] for r in rows if r["pose_id"].startswith("XC")]
    angles = [
        [float(r[n]) for n in ("yaw_deg", "pitch_deg", "roll_deg")]
        for r in rows
        if r["pose_id"].startswith("XC")
    ]
    along = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()[:, :, 2]
    np.testing.assert_allclose(positions(after), np.array(flange) + TOOL_MM * along, atol=1e-3)
    np.testing.assert_allclose(positions(after), positions(before), atol=5.0)
    # Points that the table says were left are as they were; all others are not.
    outcomes = {row["pose_id"]: row["outcome"] for row in rows}
    left = {
        name
        for name, outcome in outcomes.items()
        if outcome in ("outside_region", "beyond_limits", "too_far")
    }
    assert "XFAR" in left
    assert len(left) < 10
    point = re.compile(r"(X\w+)=(\{.*\})")
    given_points, written = dict(point.findall(before)), dict(point.findall(after))
    assert {name for name in outcomes if written[name] == given_points[name]} == left
