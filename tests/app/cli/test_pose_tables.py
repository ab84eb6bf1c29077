"""Poses loaded from tables and JSON: gaps, other units, and what is wrong in a line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from app.client.commands.record_files import FileRefused
from app.client.commands.sessions.next_view import poses_to_choose_from
from app.client.watch.files.metadata import read_table
from tests.support.command_line import gridpose


def poses_of(api: Any, session: str) -> dict[str, dict[str, Any]]:
    items = api.client.get(f"/v1/sessions/{session}/poses").json()["items"]
    return {item.pop("pose_id"): item for item in items}


def test_poses_are_loaded_from_a_table_with_gaps(served: Any, tmp_path: Path) -> None:
    session = served.make_session()
    file = tmp_path / "poses.csv"
    file.write_text(
        "pose_id;x_mm;y_mm;z_mm;yaw_deg;j1_deg;j2_deg;approach\nP1;1,5;2;-3;90;10;-20,25;left\nP2;;;;;;;\n",
        encoding="cp1252",
    )
    gridpose(served, "poses", "load", str(file), "--session", session)
    stored = poses_of(served, session)
    assert stored["P1"] == {
        "position_mm": [1.5, 2.0, -3.0],
        "roll_deg": None,
        "pitch_deg": None,
        "yaw_deg": 90.0,
        "joint_angles_deg": [10.0, -20.25],
        "approach": "left",
    }
    assert not any(value is not None for value in stored["P2"].values())


def test_tables_of_spreadsheets_may_state_their_separator_and_be_utf_16(served: Any, tmp_path: Path) -> None:
    session = served.make_session()
    file = tmp_path / "poses.csv"
    text = "sep={0}\npose_id{0}yaw_deg{0}approach\nP1{0}9{0}über\nP2{0}{1}{0}\n"
    for separator, encoding in ((";", "utf-8-sig"), (",", "cp1252"), ("\t", "utf-16"), ("|", "utf-16")):
        file.write_text(text.format(separator, "11.5"), encoding=encoding)
        gridpose(served, "poses", "load", str(file), "--session", session)
        stored = poses_of(served, session)
        assert (stored["P1"]["approach"], stored["P2"]["yaw_deg"]) == ("über", 11.5)
        assert read_table(file).commands == {
            "P1": {"yaw_deg": 9.0, "approach": "über"},
            "P2": {"yaw_deg": 11.5},
        }
    file.write_text(text.format(";", "x"), encoding="utf-16")
    assert "line 4" in gridpose(served, "poses", "load", str(file), "--session", session, code=2).stderr
    assert "line 4" in read_table(file).errors[0]


def test_poses_are_loaded_from_json_and_replaced_whole(served: Any, tmp_path: Path) -> None:
    session = served.make_session()
    file = tmp_path / "poses.json"
    file.write_text(json.dumps({"P1": {"joint_angles_deg": [1, 2]}, "P2": {"roll_deg": 3}}), encoding="utf-8")
    gridpose(served, "poses", "load", str(file), "--session", session)
    file.write_text(json.dumps([{"pose_id": "P1", "pitch_deg": 4}]), encoding="utf-8")
    gridpose(served, "poses", "load", str(file), "--session", session)
    stored = poses_of(served, session)
    assert (stored["P1"]["joint_angles_deg"], stored["P1"]["pitch_deg"]) == (None, 4.0)
    assert stored["P2"]["roll_deg"] == 3.0


@pytest.mark.parametrize(
    ("column", "advice"),
    [
        ("x_m", "State x_m in mm and name it x_mm"),
        ("position_z", "State position_z in mm and name it position_z_mm"),
        ("j1_rad", "State j1_rad in deg and name it j1_deg"),
        ("yaw", "State yaw in deg and name it yaw_deg"),
    ],
)
def test_a_column_in_another_unit_says_what_to_do(
    served: Any, tmp_path: Path, column: str, advice: str
) -> None:
    file = tmp_path / "poses.csv"
    file.write_text(f"pose_id,{column}\nP1,0.5\n", encoding="utf-8")
    refused = gridpose(served, "poses", "load", str(file), "--session", served.make_session(), code=2)
    assert advice in " ".join(refused.stderr.split())
    assert advice in read_table(file).errors[0]


@pytest.mark.parametrize("text", ["- {pose_id: no, yaw_deg: 5}", "no: {yaw_deg: 5}", "~: {yaw_deg: 5}"])
def test_a_name_that_yaml_reads_as_another_value_asks_for_quotes(
    served: Any, tmp_path: Path, text: str
) -> None:
    file = tmp_path / "poses.yaml"
    file.write_text(text, encoding="utf-8")
    refused = gridpose(served, "poses", "load", str(file), "--session", served.make_session(), code=2)
    assert "Put it in quotes" in refused.stderr


@pytest.mark.parametrize(
    ("table", "unit"),
    [
        ("pose_id,x_mm,y_mm,z_mm\nP1,0.4,0.1,0.5\nP2,0.5,-0.1,0.5\n", "metres"),
        ("pose_id,j1_deg,j2_deg\nP1,0,-1.5708\nP2,0.2,-1.2\n", "radians"),
        ("pose_id,roll_deg,pitch_deg,yaw_deg\nP1,3.14159,0,0\nP2,3.14159,0,0.3\n", "radians"),
    ],
)
def test_a_table_in_another_unit_is_refused_unless_insisted_on(
    served: Any, tmp_path: Path, table: str, unit: str
) -> None:
    session = served.make_session()
    file = tmp_path / "poses.csv"
    file.write_text(table, encoding="utf-8")
    load = ("poses", "load", str(file), "--session", session)
    refused = gridpose(served, *load, code=2)
    assert unit in refused.stderr
    assert "--accept-implausible" in refused.stderr
    assert poses_of(served, session) == {}
    gridpose(served, *load, "--accept-implausible")
    assert set(poses_of(served, session)) == {"P1", "P2"}
    assert unit in read_table(file).errors[0], "the watcher says so, too"


@pytest.mark.parametrize(
    "table",
    [
        "pose_id,x_mm,y_mm,z_mm\nP1,0,0,0\nP2,0,0,0\n",
        "pose_id,x_mm,y_mm,z_mm\nP1,1,2,3\n",
        "pose_id,x_mm,y_mm,z_mm,yaw_deg\nP1,1,2,3,2\nP2,400,2,3,2.5\n",
        "pose_id,j1_deg,j2_deg\nP1,0,1.5\nP2,30,-1\n",
    ],
)
def test_plausible_tables_are_taken(tmp_path: Path, table: str) -> None:
    file = tmp_path / "poses.csv"
    file.write_text(table, encoding="utf-8")
    assert read_table(file).errors == []


@pytest.mark.parametrize(
    ("rows", "named"),
    [
        ("P1;1.234;0;430;0 0\nP2;812,5;0;430;0 0\n", ("x_mm is 1.234 in line 2", "x_mm is 812,5 in line 3")),
        (
            "P1;812,5;0;430;0 0\nP2;1;0;430;0,5 -90.5\n",
            ("812,5 in line 2", "joint_angles_deg is -90.5 in line 3"),
        ),
        ("P1;1.234,5;0;430;0 0\n", ("x_mm is 1.234,5 in line 2",)),
    ],
)
def test_a_table_with_both_decimal_signs_is_refused_whole(
    served: Any, tmp_path: Path, rows: str, named: tuple[str, ...]
) -> None:
    """Next to 812,5 the number 1.234 may be 1234, as spreadsheets show thousands."""
    session = served.make_session()
    file = tmp_path / "poses.csv"
    file.write_text("pose_id;x_mm;y_mm;z_mm;joint_angles_deg\n" + rows, encoding="utf-8")
    refused = gridpose(served, "poses", "load", str(file), "--session", session, code=2)
    watched = read_table(file)
    for text in (" ".join(refused.stderr.split()), watched.errors[0]):
        assert all(part in text for part in (*named, "one decimal sign")), text
    assert poses_of(served, session) == {}
    assert watched.commands == {}
    with pytest.raises(FileRefused, match="one decimal sign"):
        poses_to_choose_from(file)


@pytest.mark.parametrize(
    ("table", "code", "named"),
    [
        ("pose_id,x_mm\nP1,1\n", 2, "line 2"),
        ("pose_id,j2_deg\nP1,1\n", 2, "line 2"),
        ("pose_id,yaw_deg\nP1,north\n", 2, "yaw_deg"),
        ("pose_id,yaw_deg\nP1,1_0\n", 2, "yaw_deg"),
        ("pose_id,speed\nP1,5\n", 2, "speed"),
        ("yaw_deg\n5\n", 2, "pose_id"),
        ("pose_id,yaw_deg\n", 2, "pose_id"),
        ("pose_id,yaw_deg\nP1,5\n.P2,5\n", 1, "line 3"),
        ("pose_id,yaw_deg\nP1,5\nP1,6\n", 1, "line 3"),
    ],
)
def test_a_wrong_table_names_the_line_and_stores_nothing(
    served: Any, tmp_path: Path, table: str, code: int, named: str
) -> None:
    session = served.make_session()
    file = tmp_path / "poses.csv"
    file.write_text(table, encoding="utf-8")
    refused = gridpose(served, "poses", "load", str(file), "--session", session, code=code)
    assert named in refused.stderr
    assert poses_of(served, session) == {}
