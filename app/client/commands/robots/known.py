"""Nominal Denavit-Hartenberg parameters of arms whose maker's values are public, each with its source.

Parameters of UR arms are the maker's. The others follow by `urdf` from the joint origins and axes that ROS-Industrial
publishes; axes turn as the controller counts them. Frame 0 and the flange's frame are conventions.
"""

from __future__ import annotations

from dataclasses import dataclass

from ... import Json

_UR = (
    "https://www.universal-robots.com/how-tos-and-faqs/faq/ur-faq/"
    "parameters-for-calculations-of-kinematics-and-dynamics-45257/"
)
_UR_CB3 = "Universal Robots, CB3 user manual, appendix Robot Parameter, UR5 series 3"
_UR30 = (
    "https://github.com/UniversalRobots/Universal_Robots_ROS2_Description config/ur30/default_kinematics.yaml"
)
_KUKA = "https://github.com/ros-industrial/kuka_experimental"
_ABB = "https://github.com/ros-industrial/abb"
_FANUC = "https://github.com/ros-industrial/fanuc"
_J23 = ((2, 1, 1.0),)
"""FANUC states J3 against the horizontal: the model turns by J3 + J2 (`J23_factor` of ROS-Industrial's driver)."""
_UPSIDE_DOWN = "0,0,0,180,0,0"

Rows = tuple[tuple[float, float, float, float], ...]


@dataclass(frozen=True, slots=True)
class KnownRobot:
    """An arm by its maker's data: (a mm, α °, d mm, θ offset °) per joint, couplings (joint, other, share) from 0.

    `base` is the controller's base in frame 0: upside down where the first joint counts clockwise seen from above, and
    of a FANUC its world, which is level with joint 2.
    """

    maker: str
    model: str
    rows: Rows
    source: str
    joint: str = "J"
    coupling: tuple[tuple[int, int, float], ...] = ()
    base: str | None = None

    def fields(self) -> Json:
        """Return the fields of a robot of the API."""
        names = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg")
        joints = [
            {"name": f"{self.joint}{number}", **dict(zip(names, row, strict=True))}
            for number, row in enumerate(self.rows, start=1)
        ]
        found: Json = {"manufacturer": self.maker, "model": self.model, "joints": joints}
        if self.coupling:
            count = len(joints)
            matrix = [[float(row == column) for column in range(count)] for row in range(count)]
            for joint, other, share in self.coupling:
                matrix[joint][other] = share
            found["joint_coupling"] = matrix
        return found


def _ur(
    model: str, d1: float, a2: float, a3: float, d4: float, d5: float, d6: float, source: str
) -> KnownRobot:
    rows = (
        (0.0, 90.0, d1, 0.0),
        (a2, 0.0, 0.0, 0.0),
        (a3, 0.0, 0.0, 0.0),
        (0.0, 90.0, d4, 0.0),
        (0.0, -90.0, d5, 0.0),
        (0.0, 0.0, d6, 0.0),
    )
    return KnownRobot("Universal Robots", model, rows, source)


def _fanuc(
    model: str, a1: float, d1: float, a2: float, a3: float, d4: float, last: tuple[float, float], file: str
) -> KnownRobot:
    alpha6, d6 = last
    rows = (
        (a1, -90.0, d1, 0.0),
        (a2, 180.0, 0.0, -90.0),
        (a3, -90.0, 0.0, 0.0),
        (0.0, 90.0, -d4, 0.0),
        (0.0, -90.0, 0.0, 0.0),
        (0.0, alpha6, d6, 0.0),
    )
    return KnownRobot("FANUC", model, rows, f"{_FANUC} {file}", coupling=_J23, base=f"0,0,{d1:g},0,0,0")


KNOWN = (
    _ur("UR3e", 151.85, -243.55, -213.2, 131.05, 85.35, 92.1, _UR),
    _ur("UR5e", 162.5, -425.0, -392.2, 133.3, 99.7, 99.6, _UR),
    _ur("UR10e", 180.7, -612.7, -571.55, 174.15, 119.85, 116.55, _UR),
    _ur("UR30", 236.3, -637.0, -503.7, 201.0, 159.3, 154.3, _UR30),
    _ur("UR5", 89.159, -425.0, -392.25, 109.15, 94.65, 82.3, _UR_CB3),
    KnownRobot(
        "KUKA",
        "KR 5 arc",
        (
            (180.0, 90.0, -400.0, 0.0),
            (600.0, 0.0, 0.0, 0.0),
            (120.0, 90.0, 0.0, -90.0),
            (0.0, -90.0, -620.0, 0.0),
            (0.0, 90.0, 0.0, 0.0),
            (0.0, 180.0, -115.0, -90.0),
        ),
        f"{_KUKA} kuka_kr5_support/urdf/kr5_arc_macro.xacro",
        "A",
        base=_UPSIDE_DOWN,
    ),
    KnownRobot(
        "KUKA",
        "KR 10 R1100 sixx",
        (
            (25.0, 90.0, -400.0, 0.0),
            (560.0, 0.0, 0.0, 0.0),
            (35.0, 90.0, 0.0, -90.0),
            (0.0, -90.0, -515.0, 0.0),
            (0.0, 90.0, 0.0, 0.0),
            (0.0, 180.0, -80.0, 180.0),
        ),
        f"{_KUKA} kuka_kr10_support/urdf/kr10r1100sixx_macro.xacro",
        "A",
        base=_UPSIDE_DOWN,
    ),
    KnownRobot(
        "ABB",
        "IRB 120-3/0.58",
        (
            (0.0, -90.0, 290.0, 0.0),
            (270.0, 0.0, 0.0, -90.0),
            (70.0, -90.0, 0.0, 0.0),
            (0.0, 90.0, 302.0, 0.0),
            (0.0, -90.0, 0.0, 0.0),
            (0.0, 0.0, 72.0, 180.0),
        ),
        f"{_ABB} abb_irb120_support/urdf/irb120_3_58_macro.xacro",
    ),
    _fanuc(
        "LR Mate 200iD",
        *(50.0, 330.0, 330.0, 35.0, 335.0),
        (180.0, -80.0),
        "fanuc_lrmate200id_support/urdf/lrmate200id_macro.xacro",
    ),
    _fanuc(
        "M-10iA",
        *(150.0, 450.0, 600.0, 200.0, 640.0),
        (0.0, -100.0),
        "fanuc_m10ia_support/urdf/m10ia_macro.xacro",
    ),
)


def known_robot(model: str) -> KnownRobot | None:
    """Return the arm of this model, whatever its spaces, hyphens and case; None for one that is not known."""
    return next(
        (
            robot
            for robot in KNOWN
            if _plain(model) in (_plain(robot.model), _plain(robot.maker + robot.model))
        ),
        None,
    )


def _plain(text: str) -> str:
    return "".join(c for c in text.casefold() if c.isalnum())
