"""Columns of an instrument's file by their names: which are read, which are named as unused, which are refused."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.client.commands import UploadAccess
from app.client.commands.measured_poses.command import AngleUnit, LengthUnit, import_poses
from app.client.commands.measured_poses.layout import ColumnLayout, recognised, unused_columns
from app.client.commands.measured_poses.parser import parse_poses
from app.client.commands.measured_poses.repeats import restated
from app.client.commands.record_files import FileRefused, read_records
from core.geometry.roll_pitch_yaw import rpy_to_rotation

ROW = {"pose_id": "P1", "x": "1", "y": "2", "z": "3"}


def written(folder: Path, *rows: dict[str, Any]) -> Path:
    path = folder / "readings.csv"
    lines = [",".join(rows[0]), *(",".join(map(str, row.values())) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def read(path: Path, **options: Any) -> tuple[list[dict[str, Any]], list[str]]:
    """The readings of a file without errors, and its columns that are not used."""
    records = read_records(path, None, None)
    layout = recognised(records, ColumnLayout(**options))
    poses, errors = parse_poses(records, layout)
    assert errors == []
    return [pose for _, pose in poses], unused_columns(records, layout)


@pytest.mark.parametrize("pose", ["pose", "pose_id", "Pose ID", "PoseID", "pose_name", "pose_no"])
@pytest.mark.parametrize("cycle", ["cycle", "Cycle", "cycle_no", "repetition"])
def test_poses_and_cycles_are_found_by_their_names(tmp_path: Path, pose: str, cycle: str) -> None:
    rows = [{pose: f"P{p}", cycle: c, "x": p, "y": 0, "z": c} for p in (1, 2) for c in (1, 2, 3)]
    readings, unused = read(written(tmp_path, *rows))
    assert [(r["pose_id"], r["cycle"]) for r in readings] == [(f"P{p}", c) for p in (1, 2) for c in (1, 2, 3)]
    assert unused == []
    twice = written(tmp_path, *rows, {**rows[0], "x": 99})
    _, errors = parse_poses(read_records(twice, None, None), ColumnLayout())
    assert [error.place for error in errors] == ["line 8"]


def test_columns_of_commanded_poses_are_read(tmp_path: Path) -> None:
    row = {"pose_id": "P1", "x_mm": 1, "y_mm": 2, "z_mm": 3, "roll_deg": 10, "pitch_deg": 20, "yaw_deg": 30}
    ((reading,), unused) = read(written(tmp_path, {**row, "j1_deg": 5, "j2_deg": -6}))
    assert (reading["pose_id"], reading["position_mm"]) == ("P1", [1.0, 2.0, 3.0])
    assert reading["joint_angles_deg"] == [5.0, -6.0]
    assert np.allclose(reading["rotation"], rpy_to_rotation(np.radians([10.0, 20.0, 30.0])), atol=1e-15)
    assert unused == []
    columns = {"rx": "roll_deg", "ry": "pitch_deg", "rz": "yaw_deg"}
    assert read(written(tmp_path, row), columns=columns)[0][0]["rotation"] == reading["rotation"]


@pytest.mark.parametrize(
    "names", [["j1", "j2"], ["J1 [deg]", "J2 [deg]"], ["joint_1_deg", "joint_2_deg"], ["joint1", "joint2"]]
)
def test_numbered_joints_are_read_in_their_order(tmp_path: Path, names: list[str]) -> None:
    ((reading,), unused) = read(written(tmp_path, {names[1]: 2, **ROW, names[0]: 1}))
    assert (reading["joint_angles_deg"], unused) == ([1.0, 2.0], [])


@pytest.mark.parametrize("names", [["j1", "j3"], ["j0", "j1", "j2_deg"], ["j1", "j2", "joint_1", "joint_2"]])
def test_joints_that_leave_a_choice_are_named_with_the_option(
    tmp_path: Path, names: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, {**ROW, **dict.fromkeys(names, 1)})
    assert import_poses(path, UploadAccess(), dry_run=True) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out)["joint_angles_deg"] is None
    assert f"not used: {', '.join(names)}" in shown.err
    assert "--column joints=" in shown.err


def test_units_in_names_agree_with_the_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, {"x_mm": 1, "y_mm": 2, "z_mm": 3, "j1_deg": 4})
    assert import_poses(path, UploadAccess(), lengths=LengthUnit.m, dry_run=True) == 2
    assert "--length-unit mm" in capsys.readouterr().err
    assert import_poses(path, UploadAccess(), joint_angles=AngleUnit.rad, dry_run=True) == 2
    assert "--joint-angle-unit deg" in capsys.readouterr().err
    options = {"length_mm": 1000.0, "joint_deg": math.degrees(1.0)}
    ((reading,), _) = read(written(tmp_path, {"x_m": 1, "y_m": 2, "z_m": 3, "j1_rad": 1}), **options)
    assert reading["position_mm"] == [1000.0, 2000.0, 3000.0]
    assert reading["joint_angles_deg"] == [pytest.approx(math.degrees(1.0))]
    # An option that names the column takes precedence over the unit in its name.
    columns = {axis: f"{axis}_mm" for axis in "xyz"}
    path = written(tmp_path, {"x_mm": 1, "y_mm": 2, "z_mm": 3})
    ((reading,), _) = read(path, columns=columns, length_mm=1000.0)
    assert reading["position_mm"] == [1000.0, 2000.0, 3000.0]


@pytest.mark.parametrize(
    ("columns", "options"),
    [
        (["rx", "ry", "rz"], []),
        (["Rx", "Ry", "Rz"], []),
        (["r1", "r2", "r3"], []),
        (["rz"], []),
        (["A", "B", "C"], ["rx=A", "ry=B", "rz=C"]),
        (["roll_deg", "pitch_deg", "yaw_deg"], ["rx=yaw_deg", "ry=pitch_deg", "rz=roll_deg"]),
    ],
)
def test_angles_without_a_convention_are_refused(
    tmp_path: Path, columns: list[str], options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, {**ROW, **dict.fromkeys(columns, 10)})
    assert import_poses(path, UploadAccess(), column=options, dry_run=True) == 2
    said = capsys.readouterr().err
    assert all(word in said for word in ("--rotation-format", "zyx", "xyz", "vector", "none"))
    assert import_poses(path, UploadAccess(), column=options, rotation="none", dry_run=True) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out)["rotation"] is None
    assert f"not used: {', '.join(columns)}" in shown.err


@pytest.mark.parametrize(
    ("row", "named"),
    [
        ({"qx": 0, "qy": 0, "qz": 0}, "qw"),
        ({"Pose": "P2"}, "pose=pose_id"),
        ({"X_mm": 1}, "x=x"),
        ({"qx": 0, "q_x": 0}, "qx=qx"),
        ({"q_x": 0, "q_y": 0, "q_z": 0}, "no qw"),
    ],
)
def test_what_may_be_read_in_two_ways_is_refused(tmp_path: Path, row: dict[str, Any], named: str) -> None:
    with pytest.raises(FileRefused) as refused:
        read(written(tmp_path, {**ROW, **row}))
    assert named in f"{refused.value} {refused.value.advice}"


def test_a_quaternion_has_its_names_with_or_without_an_underscore(tmp_path: Path) -> None:
    half = 0.5**0.5
    ((reading,), unused) = read(written(tmp_path, {**ROW, "q_w": half, "Q_X": 0, "q_y": 0, "q_z": half}))
    assert np.allclose(reading["rotation"], [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert unused == []


def test_a_quaternion_that_is_not_whole_is_an_error_of_its_line(tmp_path: Path) -> None:
    rows = [{**ROW, "qx": qx, "qy": 0, "qz": 0, "qw": qw} for qx, qw in ((0, 1), ("", 1), ("", ""))]
    rows[2] |= {"qy": "", "qz": ""}
    poses, errors = parse_poses(read_records(written(tmp_path, *rows), None, None), ColumnLayout())
    assert [error.place for error in errors] == ["line 3"]
    assert [pose["rotation"] is None for _, pose in poses] == [False, True]


def test_every_column_that_is_not_used_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    row = {**ROW, "time": 1, "Operator": "K", "reflector": "A", "u_x": 0.1}
    assert import_poses(written(tmp_path, row), UploadAccess(), dry_run=True) == 0
    assert "not used: time, Operator, reflector, u_x\n" in capsys.readouterr().err
    whole = {**row, "u_y": 0.1, "u_z": 0.1}
    assert read(written(tmp_path, whole))[1] == ["time", "Operator", "reflector"]
    # Uncertainties of coordinates say nothing where those of the orientation are unknown.
    turned = {**whole, "qx": 0, "qy": 0, "qz": 0, "qw": 1}
    ((reading,), unused) = read(written(tmp_path, turned))
    assert reading["covariance"] is None
    assert unused == ["time", "Operator", "reflector", "u_x", "u_y", "u_z"]
    # Both ways to state an orientation: the option decides.
    both = {**turned, "rx": 0, "ry": 0, "rz": 90}
    ((reading,), unused) = read(written(tmp_path, both), rotation="xyz")
    assert np.allclose(reading["rotation"], rpy_to_rotation(np.radians([0.0, 0.0, 90.0])), atol=1e-15)
    assert {"qx", "qy", "qz", "qw"} < set(unused)
    ((reading,), unused) = read(written(tmp_path, both))
    assert np.allclose(reading["rotation"], np.eye(3))
    assert {"rx", "ry", "rz"} < set(unused)


def test_readings_stored_with_another_content_are_counted() -> None:
    one = {"pose_id": "P1", "cycle": None, "position_mm": [1.0, 2.0, 3.0]}
    bare = {**one, "joint_angles_deg": None, "rotation": None, "covariance": None}
    with_joints = {**bare, "joint_angles_deg": [1.0, 2.0]}
    turned = {**bare, "rotation": np.eye(3).tolist()}
    assert restated([], [with_joints]) == 0
    assert restated([bare], [bare]) == 0
    assert restated([bare], [with_joints]) == restated([bare], [turned]) == restated([turned], [bare]) == 1
    assert restated([with_joints], [{**with_joints, "joint_angles_deg": [1.0, 2.5]}]) == 1
    assert restated([with_joints, bare], [with_joints]) == 0
    # Another pose, another position, and visits that have a cycle are other readings.
    for other in ({"pose_id": "P2"}, {"position_mm": [1.0, 2.0, 3.001]}, {"cycle": 1}):
        assert restated([bare], [{**with_joints, **other}]) == 0
        assert restated([{**bare, **other}], [with_joints]) == 0
