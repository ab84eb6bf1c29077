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


def test_frames_of_a_listing_that_differ_from_point_to_point_are_known(tmp_path: Path) -> None:
    point = """P[{0}]{{
   GP1:
\tUF : {1}, UT : {2},\t\tCONFIG : 'N U T, 0, 0, 0',
\tX =   500.000  mm,\tY =   -99.999  mm,\tZ =   600.000  mm,
\tW =   178.000 deg,\tP =    10.000 deg,\tR =   -20.000 deg
}};
"""
    path = tmp_path / "PART.LS"
    one, two = point.format(1, 0, 1) + point.format(2, 0, 1), point.format(3, 1, 1)
    for text, frames in ((one, {"UF 0, UT 1"}), (one + two, {"UF 0, UT 1", "UF 1, UT 1"})):
        path.write_text(f"/POS\n{text}/END\n")
        assert read_program(path, Controller.fanuc, Frame(), Frame()).frames == frames
