"""Files of instruments as readings: what is read, in which convention and unit, and which line is wrong."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.client.commands import UploadAccess
from app.client.commands.measured_poses.command import AngleUnit, import_poses
from app.client.commands.measured_poses.layout import ColumnLayout
from app.client.commands.measured_poses.parser import parse_poses
from app.client.commands.record_files import FileRefused, read_records
from core.geometry.roll_pitch_yaw import rpy_to_rotation
from core.geometry.se3 import so3_exp, so3_log

CSV = """pose;X;Y;Z;A;B;C;sx;sy;sz;sa;sb;sc;q1;q2
P1;1,5;-2;3e0;10;20;30;0,01;0,02;0,03;0,001;0,002;0,003;90;-45,5
P1;1,75;-2;3;10;20;30;0,01;0,02;0,03;0,001;0,002;0,003;90;-45,5
P2;2;0;1;-170;80;5;0,01;0,02;0,03;0,001;0,002;0,003;0;1
"""
COLUMNS = {
    **dict(zip(("x", "y", "z", "rx", "ry", "rz"), "XYZABC", strict=True)),
    **{f"u_{name}": f"s{letter}" for name, letter in zip(("x", "y", "z"), "xyz", strict=True)},
    **{f"u_{name}": f"s{letter}" for name, letter in zip(("rx", "ry", "rz"), "abc", strict=True)},
    "joints": "q1,q2",
}

BOMB = "a: &a [1, 2]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{last}'] * 10)}]\n"
    for last, name in zip("abcdefghi", "bcdefghij", strict=True)
)
"""Ten lines that stand for a thousand million numbers."""


def write(folder: Path, text: str, name: str = "readings.csv", encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_text(text, encoding=encoding)
    return path


def read(path: Path, **layout: Any) -> tuple[list[dict[str, Any]], list[tuple[str, str]]]:
    found, problems = parse_poses(read_records(path, None, None), ColumnLayout(**layout))
    return [reading for _, reading in found], [(p.place, p.message) for p in problems]


def turn(axis: int, degrees: float) -> Any:
    return so3_exp(math.radians(degrees) * np.eye(3)[axis])


def test_a_tracker_s_csv_with_decimal_commas(tmp_path: Path) -> None:
    (first, second, third), problems = read(write(tmp_path, CSV), columns=COLUMNS, rotation="xyz")
    assert problems == []
    assert [first["pose_id"], second["pose_id"], third["pose_id"]] == ["P1", "P1", "P2"]
    assert (first["cycle"], first["position_mm"], first["joint_angles_deg"]) == (
        None,
        [1.5, -2.0, 3.0],
        [90.0, -45.5],
    )
    assert np.allclose(first["rotation"], turn(0, 10) @ turn(1, 20) @ turn(2, 30), atol=1e-15)
    assert np.allclose(np.diag(first["covariance"])[:3], [1e-4, 4e-4, 9e-4])


@pytest.mark.parametrize("sequence", ["xyz", "zyx", "zxy", "yxz", "zyz", "xzx"])
def test_angles_mean_what_the_convention_says(tmp_path: Path, sequence: str) -> None:
    angles = (20.0, -35.0, 50.0)
    proper = len(set(sequence)) == 2
    names = ["r1", "r2", "r3"] if proper else [f"r{axis}" for axis in sequence]
    header = ",".join(["x", "y", "z", *names, "u_x", "u_y", "u_z", *(f"u_{n}" for n in names)])
    row = ",".join(str(v) for v in (1, 2, 3, *angles, 0.1, 0.1, 0.1, 0.001, 0.002, 0.003))
    ((reading,), problems) = read(write(tmp_path, f"{header}\n{row}\n"), rotation=sequence)
    assert problems == []
    turns = [turn("xyz".index(axis), angle) for axis, angle in zip(sequence, angles, strict=True)]
    expected = turns[0] @ turns[1] @ turns[2]
    assert np.allclose(reading["rotation"], expected, atol=1e-15)
    if sequence == "zyx":
        yaw, pitch, roll = np.radians(angles)
        assert np.allclose(reading["rotation"], rpy_to_rotation(np.array([roll, pitch, yaw])), atol=1e-15)
    # The angles' uncertainties as a small rotation from the left: what moving each angle a little does.
    J = np.zeros((3, 3))
    for k in range(3):
        moved = list(turns)
        moved[k] = turn("xyz".index(sequence[k]), angles[k] + 1e-4)
        J[:, k] = so3_log(moved[0] @ moved[1] @ moved[2] @ expected.T) / math.radians(1e-4)
    u = np.radians([0.001, 0.002, 0.003])
    assert np.allclose(
        np.array(reading["covariance"])[3:, 3:], J @ np.diag(u**2) @ J.T, rtol=1e-5, atol=1e-14
    )


def test_units_vectors_and_quaternions(tmp_path: Path) -> None:
    vector = np.array([0.3, -1.2, 2.0])
    path = write(tmp_path, "x,y,z,rx,ry,rz,q1\n0.001,0.002,0.003,0.3,-1.2,2.0,3.141592653589793\n")
    ((reading,), _) = read(
        path,
        rotation="vector",
        length_mm=1000.0,
        angle_rad=1.0,
        joint_deg=math.degrees(1.0),
        columns={"joints": "q1"},
    )
    assert reading["position_mm"] == pytest.approx([1.0, 2.0, 3.0])
    assert reading["joint_angles_deg"] == pytest.approx([180.0])
    assert np.allclose(reading["rotation"], so3_exp(vector), atol=1e-14)
    angle = float(np.linalg.norm(vector))
    q = [*(math.sin(angle / 2) * vector / angle), math.cos(angle / 2)]
    text = "x,y,z,qx,qy,qz,qw\n0,0,0," + ",".join(f"{v:.6f}" for v in q) + "\n"
    ((reading,), _) = read(write(tmp_path, text))
    assert np.allclose(reading["rotation"], so3_exp(vector), atol=5e-6)
    R = np.array(reading["rotation"])
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14


def test_positions_alone_and_poses_by_number(tmp_path: Path) -> None:
    text = "x\ty\tz\n1\t2\t3\n\n4\t5\t6\n"
    readings, problems = read(write(tmp_path, text, encoding="utf-8-sig"), prefix="T")
    assert problems == []
    assert [r["pose_id"] for r in readings] == ["T1", "T2"]
    assert readings[0]["rotation"] is readings[0]["covariance"] is readings[0]["joint_angles_deg"] is None


def test_nested_yaml_by_its_names(tmp_path: Path) -> None:
    text = """# two axes
'1593701755':
  camera_joints: []
  pose: {qw: 1.0, qx: 0.0, qy: 0.0, qz: 0.0, x: -0.5, y: 0.25, z: 1.0}
  target_joints: [-0.5, 0.25]
b:
  pose: {qw: 0.9, qx: 0.0, qy: 0.0, qz: 0.0, x: -0.5, y: 0.25, z: 1.0}
  target_joints: [-0.5, 0.25]
"""
    columns = {name: f"pose.{name}" for name in ("x", "y", "z", "qx", "qy", "qz", "qw")}
    readings, problems = read(
        write(tmp_path, text, "p.yaml"), columns={**columns, "joints": "target_joints"}, length_mm=1000.0
    )
    assert [(r["pose_id"], r["position_mm"]) for r in readings] == [("1593701755", [-500.0, 250.0, 1000.0])]
    assert readings[0]["joint_angles_deg"] == [-0.5, 0.25]
    ((place, message),) = problems
    assert place == "line 6"
    assert "0.9" in message


def test_the_service_s_own_form_passes_through(tmp_path: Path) -> None:
    own = [{"pose_id": "P1", "cycle": 2, "position_mm": [1.0, 2.0, 3.0]}]
    page = {"items": [{"id": "mpo_1", **own[0]}], "next_cursor": None}
    for content in (own, page):
        readings, problems = read(write(tmp_path, json.dumps(content), "p.json"))
        assert (readings, problems) == (own, [])
    _, problems = read(write(tmp_path, json.dumps([{**own[0], "rotations": []}]), "p.json"))
    ((place, message),) = problems
    assert place == "entry 1"
    assert "rotations" in message


@pytest.mark.parametrize(
    ("old", "new", "place", "named"),
    [
        ("1,75", "1,7x5", "line 3", "'1,7x5'"),
        ("1,75", "", "line 3", "X"),
        ("1,75", "nan", "line 3", "X"),
        ("P2", "P 2", "line 4", "'P 2'"),
        ("P2;2", ";2", "line 4", "pose"),
        ("0;1\n", "0;\n", "line 4", "q2"),
    ],
)
def test_a_wrong_cell_is_named_with_its_line(
    tmp_path: Path, old: str, new: str, place: str, named: str
) -> None:
    assert old in CSV
    text = CSV.replace(old, new)
    readings, problems = read(write(tmp_path, text), columns=COLUMNS, rotation="xyz")
    assert [where for where, _ in problems] == [place]
    assert named in problems[0][1]
    assert len(readings) == 2


def test_a_stated_decimal_sign_is_the_only_one(tmp_path: Path) -> None:
    path = write(tmp_path, "x;y;z\n1,5;1.234;3\n")
    for sign, column in ((",", "y"), (".", "x")):
        readings, problems = read(path, decimal=sign)
        assert readings == []
        assert problems[0][1].startswith(f"{column} is not a number")


def test_cycles_that_come_twice_and_joints_that_differ(tmp_path: Path) -> None:
    text = "pose,cycle,x,y,z\nP1,1,0,0,0\nP1,1,0,0,1\nP1,2,0,0,1\nP1,0,0,0,1\nP1,1.5,0,0,1\n"
    _, problems = read(write(tmp_path, text))
    assert sorted(place for place, _ in problems) == ["line 3", "line 5", "line 6"]
    assert "line 2" in dict(problems)["line 3"]
    entries = [{"x": 0, "y": 0, "z": 0, "joints": joints} for joints in ([1, 2], [1, 2, 3])]
    _, problems = read(write(tmp_path, json.dumps(entries), "p.json"))
    assert [place for place, _ in problems] == ["entry 2"]


@pytest.mark.parametrize(
    ("name", "text", "named"),
    [
        ("a.csv", "", "empty"),
        ("a.csv", "x,y,z\n", "no poses"),
        ("a.csv", "a,b,z\n1,2,3\n", "no x, y"),
        ("a.csv", "x,x,z\n1,2,3\n", "x"),
        ("a.csv", "x,y,z\n1,2\n", "Line 2"),
        ("a.csv", "x;y;z\n1,5;2.5;3\n", "y is 2.5 in line 2"),
        ("a.dat", "x,y,z\n1,2,3\n", "a.dat"),
        ("a.json", '[\n{"x": 1,}]', "Line 2"),
        ("a.json", "[" * 100_000, "nested"),
        ("a.json", "5", "list"),
        ("a.json", "[[1, 2, 3]]", "entry 1"),
        ("a.yaml", "a: [1\nb: 2", "Line 2"),
        ("a.yaml", "a: &x [1, 2]\nb: *x", "Line 2"),
        ("a.yaml", BOMB, r"\*a"),
        ("a.yaml", "!!python/object/apply:os.system ['true']", "YAML"),
    ],
)
def test_an_unreadable_file_is_refused(tmp_path: Path, name: str, text: str, named: str) -> None:
    with pytest.raises(FileRefused, match=named):
        read(write(tmp_path, text, name))


def test_a_dry_run_shows_the_first_and_asks_about_units(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path, "x,y,z,q1\n1,2,3,3.1\n1,2,3,-0.2\n")
    assert import_poses(path, UploadAccess(), column=["joints=q1"], dry_run=True) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out)["joint_angles_deg"] == [3.1]
    assert "--joint-angle-unit rad" in shown.err
    assert (
        import_poses(path, UploadAccess(), column=["joints=q1"], joint_angles=AngleUnit.rad, dry_run=True)
        == 0
    )
    shown = capsys.readouterr()
    assert json.loads(shown.out)["joint_angles_deg"] == [pytest.approx(math.degrees(3.1))]
    assert "--joint-angle-unit rad" not in shown.err


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"column": ["x"]}, "--column"),
        ({"column": ["w=x"]}, "w"),
        ({"column": ["x=absent"]}, "absent"),
        ({"rotation": "xxy"}, "--rotation-format"),
        ({"rotation": "abc"}, "--rotation-format"),
        ({"delimiter": ";;"}, "--delimiter"),
        ({"dry_run": False}, "--session"),
    ],
)
def test_invalid_options_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: dict[str, Any], named: str
) -> None:
    path = write(tmp_path, "x,y,z\n1,2,3\n")
    assert import_poses(path, UploadAccess(), **{"dry_run": True, **options}) == 2
    assert re.search(rf"(?<!\w){named}\b", capsys.readouterr().err)
