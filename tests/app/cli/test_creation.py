"""The commands that create, against a real server: from options, from a file, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from app.cli.main import app
from app.client.commands.robots.known import KNOWN
from tests.support.command_line import gridpose

BOARD = ("--kind", "chessboard", "--columns", "9", "--rows", "6", "--pitch-mm", "25")
JOINTS = [
    {"name": "A1", "a_mm": 180.0, "alpha_deg": -90.0, "d_mm": 400.0},
    {"name": "A2", "a_mm": 600.0, "alpha_deg": 0.0, "d_mm": 0.0, "theta_offset_deg": -90.0},
]


def made(api: Any, noun: str, *arguments: str) -> dict[str, Any]:
    """Create something and return it as the service has it."""
    done = gridpose(api, noun, "create", *arguments)
    (found_id,) = [line for line in done.stdout.splitlines() if line.startswith(("tgt_", "rob_", "ses_"))]
    document: dict[str, Any] = api.client.get(f"/v1/{noun}/{found_id}").json()
    return document


def test_a_target_is_made_from_options_and_from_a_file(served: Any, tmp_path: Path) -> None:
    target = made(served, "targets", "A4 [board]", *BOARD, "--pitch-sigma-mm", "0.01")
    assert (target["name"], target["kind"], target["columns"]) == ("A4 [board]", "chessboard", 9)
    assert target["pitch_standard_uncertainty_mm"] == 0.01
    file = tmp_path / "board.yaml"
    file.write_text(
        "name: from file\nkind: charuco\ncolumns: 8\nrows: 5\npitch_mm: 30\nmarker_mm: 22\ndictionary: DICT_5X5_100\n",
        encoding="utf-8",
    )
    target = made(served, "targets", "--file", str(file), "--columns", "9")
    assert (target["name"], target["columns"], target["dictionary"]) == ("from file", 9, "DICT_5X5_100")


def test_a_robot_is_made_from_options_and_from_a_file(served: Any, tmp_path: Path) -> None:
    joints = ("--joint", "180:-90:400", "--joint", "600:0:0:-90:-170:170")
    robot = made(served, "robots", "arm", *joints, "--datasheet-repeatability-mm", "0.05")
    first, second = robot["joints"]
    assert (first["a_mm"], first["alpha_deg"], first["d_mm"]) == (180.0, -90.0, 400.0)
    assert (second["theta_offset_deg"], second["minimum_deg"], second["maximum_deg"]) == (
        -90.0,
        -170.0,
        170.0,
    )
    assert robot["datasheet_repeatability_mm"] == 0.05
    file = tmp_path / "arm.json"
    file.write_text(json.dumps({"name": "stored", "joints": JOINTS}), encoding="utf-8")
    robot = made(served, "robots", "other", "--file", str(file))
    assert robot["name"] == "other"
    assert [joint["name"] for joint in robot["joints"]] == ["A1", "A2"]


def test_a_robot_is_made_from_a_table_from_a_urdf_and_by_its_model(served: Any, tmp_path: Path) -> None:
    table, urdf = tmp_path / "joints.csv", tmp_path / "arm.urdf"
    table.write_text(
        "joint;name;a_mm;alpha_deg;d_mm;beta_deg;u_a_mm\n1;A1;180;-90;400,5;;\n2;A2;600;0;0;0;1\n"
    )
    first, second = made(served, "robots", "by table", "--joints-from", str(table))["joints"]
    assert (first["name"], first["a_mm"], first["d_mm"], second["a_mm"]) == ("A1", 180.0, 400.5, 600.0)
    table.write_text("a_mm,alpha_deg,d_mm,beta_deg\n600,0.03,0,-0.04\n120,90,0,\n")
    first, second = made(served, "robots", "tilted", "--joints-from", str(table))["joints"]
    assert (first["beta_deg"], second["beta_deg"]) == (-0.04, None)
    urdf.write_text(
        '<robot name="a"><joint name="A1" type="continuous"><origin xyz="0 0 0.4"/><parent link="b"/><child link="l"/>'
        '<axis xyz="0 0 1"/></joint><joint name="A2" type="revolute"><origin xyz="0.18 0 0" rpy="-1.5708 0 0"/>'
        '<parent link="l"/><child link="tool0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint></robot>'
    )
    first, second = made(served, "robots", "by file", "--joints-from", str(urdf))["joints"]
    assert (first["name"], first["a_mm"], first["alpha_deg"], first["d_mm"]) == ("A1", 180.0, -90.0, 400.0)
    assert (first["minimum_deg"], second["maximum_deg"]) == (None, 57.2958)
    robot = made(served, "robots", "by model", "--known", "lr mate 200id")
    assert (robot["manufacturer"], robot["model"]) == ("FANUC", "LR Mate 200iD")
    assert robot["joint_coupling"][2] == [0.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    assert robot["joints"][4]["name"] == "J5"
    for noun_options in (("--known", "none"), ("--known", "UR5e", "--joint", "1:2:3")):
        gridpose(served, "robots", "create", "x", *noun_options, code=2)
    for text in (
        "a_mm,alpha_deg\n1,2\n",
        "a_mm,alpha_deg,d_mm,beta_deg\n1,2,3,x\n",
        "a_mm,r\n1,2\n",
        "a_mm\nx\n",
        "a_mm;alpha_deg;d_mm\n1.234;0;0\n600,5;0;0\n",
        "a_mm,alpha_deg,d_mm\n1_0,0,0\n",
    ):
        table.write_text(text)
        gridpose(served, "robots", "create", "x", "--joints-from", str(table), code=2)


def test_a_joint_that_is_held_is_not_one_in_radians(served: Any) -> None:
    said = gridpose(served, "robots", "create", "x", "--joint", "0:90:89:0:5:5", code=1).stderr
    assert "radians" not in said
    assert "no limits, and its angle with each pose" in " ".join(said.split())


def test_known_robots_are_listed_without_a_service() -> None:
    done = CliRunner().invoke(app, ["robots", "list", "--known"], env={"GRIDPOSE_URL": "http://127.0.0.1:9"})
    assert done.exit_code == 0
    assert all(robot.source in done.stdout for robot in KNOWN)


def test_what_is_stated_of_a_robot_is_changed(served: Any) -> None:
    robot = made(served, "robots", "cell 9", "--joint", "180:-90:400", "--serial-number", "411")
    options = ("--serial-number", "412", "--datasheet-accuracy-mm", ".4", "--joint", "180:-90:410")
    assert robot["id"] in gridpose(served, "robots", "change", "cell 9", *options).stdout
    changed = served.client.get(f"/v1/robots/{robot['id']}").json()
    assert (changed["serial_number"], changed["datasheet_accuracy_mm"]) == ("412", 0.4)
    assert (changed["joints"][0]["d_mm"], changed["name"]) == (410.0, "cell 9")
    gridpose(served, "robots", "change", "cell 9", code=2)
    coupled = ("--joint", "180:-90:400", "--joint", "600:0:0", "--joint-coupling", "2:1:-1")
    gridpose(served, "robots", "change", "cell 9", *coupled)
    changed = served.client.get(f"/v1/robots/{robot['id']}").json()
    assert changed["joint_coupling"] == [[1.0, 0.0], [-1.0, 1.0]]
    for wrong in ("2:3:1", "2:1:x", "0:1:1"):
        gridpose(served, "robots", "change", "cell 9", *coupled[:-1], wrong, code=2)
    gridpose(served, "robots", "change", "cell 9", "--joint-coupling", "2:1:1", code=2)
    gridpose(served, "robots", "change", "none", "--model", "M", code=1)


def test_a_session_is_made_with_its_targets_robot_and_lens(served: Any) -> None:
    target, robot = served.make_target(), made(served, "robots", "cell 7", "--joint", "180:-90:400")
    lens = ("--focal-length-mm", "8", "--pixel-pitch-um", "3.45")
    session = made(
        served, "sessions", "S", "--target", target, "--target", "circles:7x5:10", "--robot", "cell 7", *lens
    )
    assert session["target_ids"][0] == target
    assert len(session["target_ids"]) == 2
    assert session["robot_id"] == robot["id"]
    assert session["lens"] == {"focal_length_mm": 8.0, "pixel_pitch_um": 3.45}


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("targets", "create", "board", "--kind", "chessboard"), 2),
        (("targets", "create", *BOARD), 2),
        (("targets", "create", "board", *BOARD[:-1], "-25"), 1),
        (("robots", "create", "arm"), 2),
        (("robots", "create", "arm", "--joint", "180:-90"), 2),
        (("robots", "create", "arm", "--joint", "180:-90:nan"), 2),
        (("sessions", "create", "S"), 2),
        (("sessions", "create", "S", "--target", "tgt_none"), 1),
        (("sessions", "create", "S", "--target", "chessboard:9x6:25", "--focal-length-mm", "8"), 2),
        (("sessions", "create", "S", "--target", "chessboard:9x6:25", "--robot", "none"), 1),
    ],
)
def test_what_cannot_be_made_ends_with_a_code_and_advice(
    served: Any, arguments: tuple[str, ...], code: int
) -> None:
    assert gridpose(served, *arguments, code=code).stderr.strip()


@pytest.mark.parametrize(
    ("name", "text"), [("a.json", "[1]"), ("a.json", "{"), ("a.yaml", "a: &a 1\nb: *a\n"), ("a.yaml", "a: [")]
)
def test_a_file_that_does_not_describe_anything_is_refused(
    served: Any, tmp_path: Path, name: str, text: str
) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    gridpose(served, "robots", "create", "arm", "--file", str(tmp_path / name), code=2)


@pytest.mark.parametrize(
    "arguments",
    [
        ("targets", "board", *BOARD[:-1], "0.025"),
        ("robots", "arm", "--joint", "0.18:-90:400", "--joint", "0.6:0:0"),
    ],
)
def test_values_in_another_unit_are_made_only_if_the_user_insists(
    served: Any, arguments: tuple[str, ...]
) -> None:
    noun, name, *options = arguments
    refused = gridpose(served, noun, "create", name, *options, code=1)
    assert "--accept-implausible" in " ".join(refused.output.split())
    assert made(served, noun, name, *options, "--accept-implausible")["name"] == name


def test_a_tracker_s_file_in_metres_is_refused_with_the_option_that_states_it(
    served: Any, tmp_path: Path
) -> None:
    file = tmp_path / "tracker.csv"
    rows = [f"P{k},{c},{0.5 + 0.2 * k},{0.1 * k},{0.6 + 1e-5 * c}" for k in range(3) for c in (1, 2, 3)]
    file.write_text("\n".join(["pose,cycle,x,y,z", *rows]), encoding="utf-8")
    arguments = (
        "measured-poses",
        "import",
        str(file),
        "--session",
        "metres",
        "--target",
        "chessboard:9x6:25",
    )
    refused = gridpose(served, *arguments, code=1)
    assert "--length-unit m" in " ".join(refused.stderr.split())
    gridpose(served, *arguments, "--length-unit", "m")
