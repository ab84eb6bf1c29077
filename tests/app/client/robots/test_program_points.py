"""Which points of a robot program are found: each is, or its line is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.client.commands.robots.programs import Controller, read_program
from app.client.commands.rotations import Frame


@pytest.mark.parametrize(
    ("make", "text", "points", "left"),
    [
        # The end of an arc is a point as its auxiliary one is, and so is one that is assigned.
        (
            "kuka",
            """CIRC {X 1,Y 2,Z 3,A 4,B 5,C 6},{X 11,Y 12,Z 13,A 14,B 15,C 16}
SCIRC {X 1,Y 2,Z 3} , {X 21,Y 12,Z 13,A 14,B 15,C 16}, CA 180
XP3={X 31,Y 2,Z 3,A 4,B 5,C 6,S 2,T 3}
HOME1={AXIS: A1 1,A2 2,A3 3,A4 4,A5 5,A6 6}
P4={X 1,Y 2,Z 3,A 4,B 5,C 6}
LIN {X 100,Y 0,Z 0,A 0,B 0,C 0}:{X 1,Y 2,Z 3,A 4,B 5,C 6}
;LIN {X 1,Y 2,Z 3,A 4,B 5,C 6}
$BASE={X 100,Y 0,Z 0,A 0,B 0,C 0}
BASE_DATA[1]={FRAME: X 100,Y 0,Z 0,A 0,B 0,C 0}
""",
            {"line_1": 1.0, "line_1--2": 11.0, "line_2": 21.0, "XP3": 31.0, "HOME1": None},
            (2, 5, 6),
        ),
        # Targets taught without a name are part of the move.
        (
            "abb",
            """MoveJ [[515,0,712],[0.707107,0,0.707107,0],[0,0,0,0],[9E+09,9E9,9E9,9E9,9E9,9E9]],v1000,z50,tool0;
MoveAbsJ [[0,0,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]]\\NoEOffs,v1000,z50,tool0;
MoveC [[1,2,3],[1,0,0,0],[0,0,0,0],AXES],[[2,2,3],[1,0,0,0],[0,0,0,0],AXES],v1000,z50,tool0;
p2:=[[3,2,3],[1,0,0,0],[0,0,0,0],AXES];
MoveL [[nX,0,712],[1,0,0,0],[0,0,0,0],AXES],v100,fine,tool0;
! CONST robtarget old:=[[1,2,3],[1,0,0,0],[0,0,0,0],AXES];
frame:=[[1,2,3],[1,0,0,0]];
PERS wobjdata w:=[FALSE,TRUE,"",[[1,2,3],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
""".replace("AXES", "[9E9,9E9,9E9,9E9,9E9,9E9]"),
            {"line_1": 515.0, "line_2": None, "line_3": 1.0, "line_3--2": 2.0, "p2": 3.0},
            (5,),
        ),
        # Frames are no points, nor are offsets from them; a pose of a list is named.
        (
            "ur",
            """tcp = p[0,0,0.15,0,0,0]
set_tcp(tcp)
feature = p[.1,.2,.3,0,0,1]
above = p[.4,.2,.3,0,3,0]
movel(pose_trans(feature, p[.01,0,0,0,0,0]), a=1)
movel(pose_trans(above, p[0,0,-.1,0,0,0]), a=1)
movel(above, a=1)
movej([d2r(10), -1.5, 1.4, 0.2, 0.3, 0.4], a=1.4)
# movej([0.1, -1.5, 1.4, 0.2, 0.3, 0.4], a=1.4)
path = [p[.4,.2,.3,0,3,0], p[.5,.2,.3,0,3,0]]
shifted = pose_add(above, p[0,0,-.1,0,0,0])
force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,10,0,0,0], 2, [.1,.1,.15,.3,.3,.3])
""",
            {"above": 400.0},
            (1, 3, 5, 6, 8, 10, 11),
        ),
        # The second group of axes is another robot, or a positioner.
        (
            "fanuc",
            """/POS
P[1]{
   GP1:
\tUF : 0, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',
\tX =   500.000  mm,\tY =   -99.999  mm,\tZ =   600.000  mm,
\tW =   178.000 deg,\tP =    10.000 deg,\tR =   -20.000 deg
   GP2:
\tUF : 0, UT : 1,\t
\tJ1=     1.000 deg,\tJ2=   -10.250 deg,\tJ3=     1.000 deg,
\tJ4=     2.000 deg,\tJ5=   -70.000 deg,\tJ6=     5.000 deg
};
P[2]{
   GP2:
\tUF : 0, UT : 1,\t
\tJ1=     1.000 deg,\tJ2=   -10.250 deg,\tJ3=     1.000 deg,
\tJ4=     2.000 deg,\tJ5=   -70.000 deg,\tJ6=     5.000 deg
};
/END
""",
            {"P1": 500.0},
            (12,),
        ),
    ],
)
def test_every_point_is_found_or_named_and_no_frame_is_one(
    tmp_path: Path, make: str, text: str, points: dict[str, float | None], left: tuple[int, ...]
) -> None:
    path = tmp_path / "program"
    path.write_text(text)
    found = read_program(path, Controller(make), Frame(), Frame())
    x_mm = {
        one["pose_id"]: one["position_mm"][0] if "position_mm" in one else None for one in found.commands()
    }
    assert x_mm == {name: x if x is None else pytest.approx(x) for name, x in points.items()}
    assert found.incomplete_lines == left


KUKA_POINT = "DECL E6POS X{0}={{X 1.0,Y 2.0,Z 3.0,A 4.0,B 5.0,C 6.0,S 2,T 35}}\n"
KUKA_FORM = 'DECL FDAT F{0}={{TOOL_NO {1},BASE_NO {2},IPO_FRAME #BASE,POINT2[] " "}}\n'
ABB_POINT = "CONST robtarget p1:=[[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n"
FANUC_POINT = """P[{0}]{{
   GP1:
\tUF : {1}, UT : {2},\t\tCONFIG : 'N U T, 0, 0, 0',
\tX =   500.000  mm,\tY =   -99.999  mm,\tZ =   600.000  mm,
\tW =   178.000 deg,\tP =    10.000 deg,\tR =   -20.000 deg
}};
"""


@pytest.mark.parametrize(
    ("make", "text", "frames"),
    [
        (
            "kuka",
            # The home position is given as joint angles: its base is that of no point.
            KUKA_POINT.format("P1") + KUKA_FORM.format("P1", 1, 2) + KUKA_FORM.format("HOME", 0, 0),
            {"TOOL_NO 1, BASE_NO 2"},
        ),
        (
            "kuka",
            "".join(
                KUKA_POINT.format(f"P{base}") + KUKA_FORM.format(f"P{base}", 1, base) for base in (1, 2, 3)
            ),
            {"TOOL_NO 1, BASE_NO 1", "TOOL_NO 1, BASE_NO 2", "TOOL_NO 1, BASE_NO 3"},
        ),
        ("kuka", "$BASE=BASE_DATA[1]\n$TOOL = TOOL_DATA[1]\n" + KUKA_POINT.format("P1"), set()),
        (
            "kuka",
            "$TOOL=TOOL_DATA[1]\n$BASE=BASE_DATA[1]\n;$BASE=BASE_DATA[3]\n$base = BASE_DATA[2]\n"
            + KUKA_POINT.format("P1"),
            {"$BASE=BASE_DATA[1]", "$BASE=BASE_DATA[2]"},
        ),
        (
            "abb",
            ABB_POINT
            + "MoveAbsJ jhome, v100, fine, tool0;\nMoveL p1,v100,z10,Gun\\WObj:=part;\n! MoveL p1,v1,fine,other;\n"
            "MoveC Offs(p1,0,0,10), p1\\ID:=3, v100\\T:=2, fine\\Inpos:=x, gun \\WObj := Part \\Corr;\n",
            {"gun, part"},
        ),
        (
            "abb",
            ABB_POINT + "MoveJ p1,v100,z10,gun;\nMoveL p1,v100,z10,gun\\WObj:=part;\n",
            {"gun, wobj0", "gun, part"},
        ),
        (
            "ur",
            "set_tcp(p[0,0,0.1,0,0,0])\nmovel(p[.4,0,.3,0,3,0])\nset_tcp(p[0, 0, 0.1, 0, 0, 0])\n",
            {"set_tcp(p[0,0,0.1,0,0,0])"},
        ),
        (
            "ur",
            "set_tcp(gun)\nmovel(p[.4,0,.3,0,3,0])\nset_tcp(gripper)\nmovel(p[.4,0,.3,0,3,0])\n",
            {"set_tcp(gun)", "set_tcp(gripper)"},
        ),
        (
            "fanuc",
            "/POS\n" + FANUC_POINT.format(1, 0, 1) + FANUC_POINT.format(2, 0, 1) + "/END\n",
            {"UF 0, UT 1"},
        ),
        (
            "fanuc",
            "/POS\n" + FANUC_POINT.format(1, 0, 1) + FANUC_POINT.format(2, 1, 1) + "/END\n",
            {"UF 0, UT 1", "UF 1, UT 1"},
        ),
    ],
)
def test_the_frames_that_a_program_names_for_its_points_are_known(
    tmp_path: Path, make: str, text: str, frames: set[str]
) -> None:
    path = tmp_path / "program"
    path.write_text(text)
    assert read_program(path, Controller(make), Frame(), Frame()).frames == frames
