"""Points of robot programs: what they mean, by another library's rotations, and that only their numbers change."""

from __future__ import annotations

import re
from pathlib import Path, PurePath

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.client.commands.robots.programs import (
    Controller,
    Program,
    ProgramRefused,
    controller_of,
    read_program,
)
from app.client.commands.rotations import Frame, parse_frame

KUKA = """&ACCESS RVP\r
DEFDAT  PART1 PUBLIC\r
;FOLD EXTERNAL DECLARATIONS \xe9\r
DECL E6POS XP1={X 1200.5,Y -30.25,Z 900.0,A 170.0,B -5.5,C 178.0,S 2,T 35,E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}\r
DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE,POINT2[] " "}\r
DECL LDAT LCPDAT1={VEL 2.0,ACC 100.0,APO_DIST 100.0}\r
DECL GLOBAL E6AXIS XHOME={A1 0.0,A2 -90.0,A3 90.0,A4 10.0,A5 30.0,A6 -5.0,E1 0.0}\r
DECL FRAME OFFSET={X 1.0,Y 2.0,Z 3.0,A 4.0,B 5.0,C 6.0}\r
ENDDAT\r
PTP {A1 10,A2 -80}\r
LIN {X 1.0,Y 2.0,Z 3.0,A 40.0,B 5.0,C 6.0} C_DIS\r
"""
ABB = """MODULE Part1
  ! CONST robtarget old:=
  TASK PERS tooldata gun:=[TRUE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
  CONST robtarget p10:=[[600.5,-50,225.3],[0.1830127,-0.6830127,0.6830127,0.1830127],[1,1,0,0],AXES];
  LOCAL VAR jointtarget j10:=[[0,10.5,-20,0,30,0],AXES];
  CONST robtarget many{2}:=[[[1,2,3],[1,0,0,0],[0,0,0,0],AXES],[[1,2,3],[1,0,0,0],[0,0,0,0],AXES]];
  PROC main()
    MoveL p10, v100, fine, gun;
  ENDPROC
ENDMODULE
""".replace("AXES", "[9E9,9E9,9E9,9E9,9E9,9E9]")
UR = """def part():
  set_tcp(p[0.0,0.0,0.1,0.0,0.0,0.0])
  global Waypoint_1_p=p[.4, -.2, 0.3, 2.1, -1.2, 0.4]
  global Waypoint_1_q=[-0.5, -1.6, 1.5, -1.4, -1.57, 0.1]
  movej([0.1, -1.5, 1.4, 0.2, 0.3, 0.4], a=1.4, v=1.05)
  movej(get_inverse_kin(Waypoint_1_p, qnear=Waypoint_1_q), a=1.2, v=0.25)
  movec(p[0.5, 0, 0.3, 3.1, 0, 0], p[0.5, 0.1, 0.3, 3.1, 0, 0], a=1.2, v=0.25)
  weights = [1, 2, 3]
  selection = [0, 0, 1, 0, 0, 0]
  speeds = [0.0, -0.3, 0.2, -0.1, 0.1, 0.0]
  speedj(speeds, 0.5, 2)
end
"""
FANUC = """/PROG  PART1
/MN
   1:J P[1:home] 100% FINE    ;
   2:L P[2] 100mm/sec FINE    ;
/POS
P[1:"home"]{
   GP1:
\tUF : 0, UT : 1,\t
\tJ1=     0.000 deg,\tJ2=   -10.250 deg,\tJ3=    20.000 deg,
\tJ4=     0.000 deg,\tJ5=   -70.000 deg,\tJ6=     5.000 deg
};
P[2]{
   GP1:
\tUF : 0, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',
\tX =   500.000  mm,\tY =   -99.999  mm,\tZ =   600.000  mm,
\tW =   178.000 deg,\tP =    10.000 deg,\tR =   -20.000 deg
};
P[3]{
   GP1:
\tUF : 0, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',
\tX = ********  mm,\tY = ********  mm,\tZ = ********  mm,
\tW = ******** deg,\tP = ******** deg,\tR = ******** deg
};
/END
"""
PROGRAMS = {
    Controller.kuka: ("part1.dat", KUKA),
    Controller.abb: ("Part1.mod", ABB),
    Controller.ur: ("part.script", UR),
    Controller.fanuc: ("PART1.LS", FANUC),
}
BASE = "100,-50,20,5,-10,80"
TOOL = "1,2,150,0,90,-30"


def program(folder: Path, make: Controller, base: Frame | None = None, tool: Frame | None = None) -> Program:
    name, text = PROGRAMS[make]
    path = folder / name
    path.write_bytes(text.encode("latin-1"))
    assert controller_of(path) is make
    return read_program(path, make, base or Frame(), tool or Frame())


def rotation(command: dict[str, float]) -> np.ndarray:
    angles = [command[name] for name in ("yaw_deg", "pitch_deg", "roll_deg")]
    return np.asarray(Rotation.from_euler("ZYX", angles, degrees=True).as_matrix())


@pytest.mark.parametrize(
    ("make", "pose_id", "position_mm", "turned"),
    [
        (
            "kuka",
            "XP1",
            (1200.5, -30.25, 900.0),
            Rotation.from_euler("ZYX", [170.0, -5.5, 178.0], degrees=True),
        ),
        ("kuka", "line_11", (1.0, 2.0, 3.0), Rotation.from_euler("ZYX", [40.0, 5.0, 6.0], degrees=True)),
        (
            "abb",
            "p10",
            (600.5, -50.0, 225.3),
            Rotation.from_quat([-0.6830127, 0.6830127, 0.1830127, 0.1830127]),
        ),
        ("ur", "Waypoint_1_p", (400.0, -200.0, 300.0), Rotation.from_rotvec([2.1, -1.2, 0.4])),
        ("ur", "line_7", (500.0, 0.0, 300.0), Rotation.from_rotvec([3.1, 0.0, 0.0])),
        ("ur", "line_7--2", (500.0, 100.0, 300.0), Rotation.from_rotvec([3.1, 0.0, 0.0])),
        (
            "fanuc",
            "P2",
            (500.0, -99.999, 600.0),
            Rotation.from_euler("xyz", [178.0, 10.0, -20.0], degrees=True),
        ),
    ],
)
def test_cartesian_points_mean_what_the_maker_says(
    tmp_path: Path, make: str, pose_id: str, position_mm: tuple[float, ...], turned: Rotation
) -> None:
    found = {one["pose_id"]: one for one in program(tmp_path, Controller(make)).commands()}
    assert found[pose_id]["position_mm"] == pytest.approx(position_mm)
    np.testing.assert_allclose(rotation(found[pose_id]), turned.as_matrix(), atol=1e-7)


@pytest.mark.parametrize(
    ("make", "angles"),
    [
        ("kuka", {"XHOME": [0.0, -90.0, 90.0, 10.0, 30.0, -5.0]}),
        ("abb", {"j10": [0.0, 10.5, -20.0, 0.0, 30.0, 0.0]}),
        (
            "ur",
            {
                "Waypoint_1_q": np.degrees([-0.5, -1.6, 1.5, -1.4, -1.57, 0.1]).tolist(),
                "line_5": np.degrees([0.1, -1.5, 1.4, 0.2, 0.3, 0.4]).tolist(),
            },
        ),
        ("fanuc", {"P1": [0.0, -10.25, 20.0, 0.0, -70.0, 5.0]}),
    ],
)
def test_joint_points_are_in_degrees(tmp_path: Path, make: str, angles: dict[str, list[float]]) -> None:
    commands = program(tmp_path, Controller(make)).commands()
    found = {one["pose_id"]: one["joint_angles_deg"] for one in commands if "joint_angles_deg" in one}
    assert found == {name: pytest.approx(values) for name, values in angles.items()}


@pytest.mark.parametrize("make", Controller)
def test_what_is_not_corrected_stays_byte_by_byte(tmp_path: Path, make: Controller) -> None:
    assert program(tmp_path, make).with_commands({}) == PROGRAMS[make][1].encode("latin-1")


@pytest.mark.parametrize("make", Controller)
def test_points_written_in_frames_are_read_again_and_nothing_else_changes(
    tmp_path: Path, make: Controller
) -> None:
    one = program(tmp_path, make, parse_frame(BASE), parse_frame(TOOL))
    moved = {}
    for command in one.commands():
        if "joint_angles_deg" in command:
            moved[command["pose_id"]] = {
                "joint_angles_deg": [a + 0.0125 for a in command["joint_angles_deg"]]
            }
        else:
            shifted = [value + 0.25 for value in command["position_mm"]]
            turned = {name: command[name] + 0.01 for name in ("roll_deg", "pitch_deg", "yaw_deg")}
            moved[command["pose_id"]] = {"position_mm": shifted, **turned}
    written = one.with_commands(moved)
    path = tmp_path / f"written{PurePath(PROGRAMS[make][0]).suffix}"
    path.write_bytes(written)
    again = read_program(path, make, parse_frame(BASE), parse_frame(TOOL))
    coarse = make is Controller.fanuc  # its listings have three decimals
    for command in again.commands():
        wanted = moved[command["pose_id"]]
        if "joint_angles_deg" in command:
            assert command["joint_angles_deg"] == pytest.approx(
                wanted["joint_angles_deg"], abs=6e-4 if coarse else 6e-6
            )
        else:
            assert command["position_mm"] == pytest.approx(
                wanted["position_mm"], abs=5e-3 if coarse else 1e-4
            )
            turn = Rotation.from_matrix(rotation(command).T @ rotation(wanted)).magnitude()
            assert np.degrees(turn) < (2e-3 if coarse else 2e-5)
    digits = r"[-+.0-9eE]+"
    assert _without(digits, written.decode("latin-1")) == _without(digits, PROGRAMS[make][1])


def test_columns_of_a_listing_stay_aligned(tmp_path: Path) -> None:
    one = program(tmp_path, Controller.fanuc)
    command = next(c for c in one.commands() if c["pose_id"] == "P2")
    command["position_mm"] = [500.0, -100.001, 600.0]
    written = one.with_commands({"P2": command}).decode()
    assert "X =   500.000  mm,\tY =  -100.001  mm,\tZ =   600.000  mm" in written
    assert len(written) == len(FANUC)


@pytest.mark.parametrize(
    ("make", "lines"), [("kuka", (10,)), ("abb", (6,)), ("ur", (9, 10)), ("fanuc", (18,))]
)
def test_points_that_are_not_whole_are_named_by_their_lines(
    tmp_path: Path, make: str, lines: tuple[int, ...]
) -> None:
    assert program(tmp_path, Controller(make)).incomplete_lines == lines


def test_what_is_no_program_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "empty.mod"
    path.write_text("MODULE empty\nENDMODULE\n")
    with pytest.raises(ProgramRefused, match="holds no points"):
        read_program(path, Controller.abb, Frame(), Frame())
    path.write_text("CONST robtarget p:=[[1,2,3],[0,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n")
    with pytest.raises(ProgramRefused, match="line 1"):
        read_program(path, Controller.abb, Frame(), Frame()).commands()


@pytest.mark.parametrize("text", ["1,2,3", "1,2,3,4,5,six", "0,0,nan,0,0,0"])
def test_a_frame_has_six_numbers(text: str) -> None:
    with pytest.raises(ValueError, match=r"six numbers|could not convert"):
        parse_frame(text)


def _without(pattern: str, text: str) -> str:
    return re.sub(r" +", " ", re.sub(pattern, "#", text))
